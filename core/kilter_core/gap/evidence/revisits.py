"""What poses that were revisited at another time say of a law of time: only these tell time from what went with it (trap 19).

Whatever follows the posture is the same at every visit of a pose, known to the library or not, so what differs between
visits owes nothing to it. The law is fitted to the poses without these differences, which it then must predict by sign
and by size. Where the other poses leave it open (every pose was measured early and late), the differences are asked by
themselves whether there is any such law in them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from scipy.stats import f as f_distribution
from scipy.stats import norm
from scipy.stats import t as t_distribution

from kilter_core.gap.evidence.fits.final_fit import amounts
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.gram import orthonormal
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.observations import Observations
from kilter_core.observations.repeats import numbered_rows
from kilter_core.types import Bools, Floats, Ints

NEAR_RAD = 0.01  # rad or m in every joint within which a pose was revisited: smooth errors differ by a hundredth there
WIDE = 3.0  # times that: rows that hang together over more are a motion, not revisits
SHARP = 3.0  # standard deviations of what is predicted: less is seen or missed by chance
SOLID = 1e-6  # of a column's length: less of it between visits is rounding


@dataclass(frozen=True)
class Revisits:
    """How visits of ``poses`` differ by a law of time: by ``predicted`` (m or rad, rms), and by ``slope`` times that.

    ``sigma`` is the slope's standard deviation, ``alone`` those by which the differences show the law at all. The
    prediction is ``held_out`` where it is that of the other poses.
    """

    poses: int
    predicted: float
    slope: float
    sigma: float
    alone: float
    held_out: bool

    @property
    def deviation_in_sigmas(self) -> float:
        """Standard deviations between what is seen and what was predicted."""
        return abs(self.slope - 1.0) / self.sigma

    @property
    def sharp(self) -> bool:
        """Whether a right prediction would have been seen."""
        return self.held_out and self.sigma * SHARP < 1.0


@dataclass(frozen=True)
class Contrasts:
    """What differs between the visits of a pose: rows (R,) less what all of its visits have in common.

    ``blocks`` are the rows of each pose with a basis of that; ``free`` numbers are left of them.
    """

    blocks: tuple[tuple[Ints, Floats], ...]
    free: int

    @staticmethod
    def from_problem(problem: LinearizedProblem) -> Contrasts:
        """By whitened rows, where a shift that all visits share is whitened by each one's own noise."""
        settings, source = problem.settings, problem.settings.source
        seen = ~np.isnan(source.residual(problem.values)) & settings.used[:, None]
        size = seen.shape[1]
        ways = settings.whitening.columns(np.eye(size) * seen[:, None, :]).reshape(*seen.shape, size)
        blocks, free = [], 0
        for visits in _groups(number_revisited_poses(source.observations, settings.group), settings.used):
            basis = orthonormal(ways[visits].reshape(-1, size))
            rows = (visits[:, None] * size + np.arange(size)).reshape(-1)
            blocks.append((rows, basis))
            free += int(seen[visits].sum()) - basis.shape[1]
        return Contrasts(tuple(blocks), free)

    def __call__(self, X: Floats) -> Floats:
        """Differences (R,) or (R, K), zero where no pose was revisited."""
        out = np.zeros_like(X)
        for rows, basis in self.blocks:
            out[rows] = X[rows] - basis @ (basis.T @ X[rows])
        return out


def number_revisited_poses(rows: Observations, pose: Ints) -> Ints:
    """Number (V,) what revisits share beside the approach: a pose, near by too, with its payload, session and contact."""
    beside = (rows.payload_kg, rows.payload_com, rows.session, rows.setup, rows.socket, rows.plane, rows.bar)
    columns = [c.reshape(len(c), -1).astype(np.float64) for c in beside if c is not None]
    alike = np.hstack([_merge_near_poses(rows.q, pose).astype(np.float64)[:, None], *columns])
    return numbered_rows(np.unique(alike, return_inverse=True)[1].reshape(alike.shape))


def _merge_near_poses(q: Floats, pose: Ints) -> Ints:
    """Poses (V,) numbered so that near ones share a number, unless they hang together as a motion does."""
    pairs = KDTree(q).query_pairs(NEAR_RAD, p=np.inf, output_type="ndarray")
    linked = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(q), len(q)))
    group = connected_components(linked, directed=False)[1].astype(np.int64)
    out = pose.copy()
    for visits in _groups(group, np.ones(len(q), dtype=bool)):
        if np.ptp(q[visits], axis=0).max() <= WIDE * NEAR_RAD:
            out[visits] = pose[visits[0]]
    return out


def _groups(group: Ints, used: Bools) -> Iterator[Ints]:
    """The visits of each group of two or more."""
    order = np.flatnonzero(used)[np.argsort(group[used], kind="stable")]
    for visits in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
        if len(visits) > 1:
            yield visits


def revisits(search: SearchResult, place: int) -> Revisits | None:
    """Ask the revisited poses about a chosen candidate; None where they say nothing of it."""
    asked = _Asked.from_search(search, place)
    if asked is None:
        return None
    told = asked.compare_with_other_poses()
    return told if told is not None and told.sharp else asked.by_themselves() or told


@dataclass(frozen=True)
class _Asked:
    """A candidate's columns between visits (R, K), and what the data (R,) say there, with all else taken out of both."""

    search: SearchResult
    columns: tuple[int, ...]
    contrasts: Contrasts
    law: Floats
    left: Floats
    free: int

    @staticmethod
    def from_search(search: SearchResult, place: int) -> _Asked | None:
        problem, columns = search.problem, search.selector.scorer.candidates[place].columns
        contrasts = Contrasts.from_problem(problem)
        rest = search.selector.columns([k for k in search.chosen if k != place])
        law = problem.projected_columns(list(columns))
        changes = contrasts(law)
        if not np.linalg.norm(changes) > SOLID * np.linalg.norm(law):
            return None
        other = np.hstack([contrasts(problem.projected_columns(rest)), contrasts(_reversals(problem))])
        basis = orthonormal(other) if other.shape[1] else other
        left, changes = (x - basis @ (basis.T @ x) for x in (contrasts(problem.y), changes))
        free = contrasts.free - basis.shape[1]
        return _Asked(search, columns, contrasts, changes, left, free) if free > 0 else None

    def compare_with_other_poses(self) -> Revisits | None:
        """Against the amplitude that the poses have without these differences."""
        amount, covariance = self._elsewhere()
        slope = self._slope(amount)
        if slope is None:
            return None
        value, sigma, freedom, predicted = slope
        about = float(predicted @ self.law @ covariance @ self.law.T @ predicted) / float(predicted @ predicted) ** 2
        chance = t_distribution.sf(value / sigma, freedom)
        return self._build_revisits(predicted, value, float(np.hypot(sigma, np.sqrt(about))), chance, True)

    def by_themselves(self) -> Revisits | None:
        """Whether the differences have any such law in them (likelihood ratio), and the size that the whole fit has."""
        u = orthonormal(self.law)
        free = self.free - u.shape[1]
        amount = self._fitted_amounts()
        slope = self._slope(amount)
        if slope is None or free <= 0 or not u.shape[1]:
            return None
        taken, total = float(np.sum((u.T @ self.left) ** 2)), float(self.left @ self.left)
        ratio = taken / u.shape[1] / max((total - taken) / free, 1e-300)
        # Both: any such law in the differences, and this one, which many amplitudes at once would leave open.
        chance = max(
            float(f_distribution.sf(ratio, u.shape[1], free)), float(t_distribution.sf(slope[0] / slope[1], slope[2]))
        )
        return self._build_revisits(slope[3], slope[0], slope[1], chance, False)

    def _build_revisits(self, predicted: Floats, slope: float, sigma: float, chance: float, held_out: bool) -> Revisits:
        settings, blocks = self.search.problem.settings, self.contrasts.blocks
        size = settings.whitener.shape[-1]
        visits = np.concatenate([rows[::size] // size for rows, _ in blocks])
        moved = settings.source.rms(settings.whitening.back(predicted)[visits])
        alone = float(norm.isf(np.clip(chance, 1e-300, 1.0 - 1e-15)))
        return Revisits(len(blocks), moved, slope, sigma, alone, held_out)

    def _slope(self, amount: Floats) -> tuple[float, float, float, Floats] | None:
        """What is seen over what is predicted, its standard deviation by the scatter left, the freedom of that."""
        predicted = self.law @ amount
        size = float(predicted @ predicted)
        if size <= 0.0 or self.free < 2:
            return None
        slope = float(predicted @ self.left) / size
        scatter = float(np.sum((self.left - slope * predicted) ** 2)) / (self.free - 1)
        return slope, float(np.sqrt(max(scatter, 1e-300) / size)), self.free - 1.0, predicted

    def _elsewhere(self) -> tuple[Floats, Floats]:
        """Amounts (K,) of unit columns, and their covariance, by the data without any difference between visits."""
        problem, search = self.search.problem, self.search
        columns = [*self.columns, *(k for k in search.columns if k not in self.columns)]
        B = problem.projected_columns(columns)
        B -= self.contrasts(B)
        y = problem.y - self.contrasts(problem.y)
        amount, covariance = amounts(search, columns, B, y)
        own = slice(0, len(self.columns))
        return amount[own], covariance[own, own]

    def _fitted_amounts(self) -> Floats:
        """Amounts (K,) of unit columns by all data."""
        solved = dict(zip(self.search.columns, self.search.problem.gram.solve(self.search.columns), strict=True))
        return np.array([solved[k] for k in self.columns])


def _reversals(problem: LinearizedProblem) -> Floats:
    """Whitened columns (R, n) of each joint by the side it came from: an approach changes them, not time."""
    source = problem.settings.source
    direction = source.observations.direction
    if direction is None:
        return np.zeros((len(problem.y), 0))
    column = source.joint_columns(problem.values)
    joints: Sequence[Floats] = [
        np.nan_to_num(column(j) * np.nan_to_num(direction[:, j])[:, None]) for j in range(direction.shape[1])
    ]
    return problem.settings.whitening.columns(np.stack(joints, axis=2))
