"""What a named effect does to its joint over the quantity that it follows, beside what each visit says of it.

The lever arm is divided out: a visit whose tool lies far from the axis of the joint, and one that lies near, say the same
angle, the one more surely than the other. The joints that an effect rotates, and the quantity that it follows there,
are found by asking the effect itself; no list of effects says so.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from kilter_core.effects import Batch
from kilter_core.effects.batch import NOT_OF_ROWS
from kilter_core.effects.physical import JOINT_CURVE
from kilter_core.gap.evidence.fits.final_fit import Amounts, final_effect_amounts, widening
from kilter_core.gap.evidence.fits.intervals import interval_width
from kilter_core.gap.evidence.verdict import Judged
from kilter_core.gap.search.candidates import JOINT, Candidate
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.parameters import degrees, display_unit_and_scale
from kilter_core.types import Bools, Floats

MOST_VISITS = 400
LOOKED_AT = 500  # visits, more or less, on which the quantity that an effect follows is found
FEWEST_POINTS, MOST_POINTS = 121, 1500  # of a curve
A_WAVE = 16  # points of a curve for each of its waves
SAME = 1e-6  # of an effect, what it may differ by where only what it follows is the same
FAINT = 4.0  # times the median uncertainty of a visit, from which a visit says too little of the joint to be drawn
SIDES = (1.0, -1.0)
TURN_DEG = 360.0  # over which a curve of a joint is known at every angle


@dataclass(frozen=True)
class Follows:
    """The quantity that an effect follows at a joint: a column of the conditions, and perhaps the ``direction`` of motion.

    ``of_joint`` says whether the column has a value for each joint; ``unit`` is that at a revolute joint and at a
    prismatic one, SI.
    """

    name: str
    of_joint: bool
    units: tuple[str, str]
    two_sided: bool = False

    def values_at_joint(self, batch: Batch, joint: int) -> Floats:
        """Its values in the rows (N,)."""
        column = getattr(batch, self.name)
        return np.asarray(column[:, joint] if self.of_joint else column)

    def synthetic_batch(self, batch: Batch, joint: int, x: Floats, side: Floats) -> Batch:
        """Conditions like those of the first row, but for this quantity ``x (K,)`` and the direction ``side (K,)``."""
        first = {k: v[:1] for k, v in vars(batch).items() if isinstance(v, np.ndarray) and k not in NOT_OF_ROWS}
        rows = {k: np.repeat(v, len(x), axis=0) for k, v in first.items()}
        rows[self.name] = _replace_joint_column(rows[self.name], joint, x) if self.of_joint else x
        if self.two_sided:
            rows["direction"] = _replace_joint_column(rows["direction"], joint, side)
        return replace(batch, **rows, slopes=None)


QUANTITIES = tuple(
    replace(one, two_sided=two_sided)
    for one in (
        Follows("q", True, ("rad", "m")),
        Follows("axial", True, ("N m", "N")),
        Follows("t", False, ("s", "s")),
        Follows("temperature_c", False, ("degC", "degC")),
    )
    for two_sided in (False, True)
)


@dataclass(frozen=True)
class Visits:
    """What the visits say of a joint beyond what is predicted: ``left (V,)`` and its standard deviation, rad or m."""

    used: Bools
    left: Floats
    sigma: Floats


def effect_curves(search: SearchResult, effects: Sequence[Judged]) -> list[dict[str, Any]]:
    """A curve for each joint that a named effect rotates (or shifts) as one quantity tells; units as in a report."""
    out: list[dict[str, Any]] = []
    if not effects:
        return out
    fit = final_effect_amounts(search)
    for judged in effects:
        place = judged.evidence.place
        alike = {alias.candidate.label for alias in judged.alias_set}
        for joint in search.selector.scorer.candidates[place].joints or ():
            curve = _curve(search, fit, place, joint, alike)
            out += [] if curve is None else [curve]
    return out


def _curve(search: SearchResult, fit: Amounts, place: int, joint: int, alike: set[str]) -> dict[str, Any] | None:
    """The curve of a chosen candidate at a joint, None where no single quantity tells it."""
    candidate, source = search.selector.scorer.candidates[place], search.problem.settings.source
    found = next(_find_followed_quantities(candidate, source.batch, joint, search), None)
    if found is None:
        return None
    visits = _visits(search, joint)
    if not np.any(visits.used):
        return None
    return _Drawn(search, fit, candidate, joint, found, visits).document(alike)


def _find_followed_quantities(
    candidate: Candidate, batch: Batch, joint: int, search: SearchResult
) -> Iterator[Follows]:
    """Quantities that tell what the candidate does at the joint, all else as in the first row."""
    batch = batch.select_rows(slice(None, None, max(1, len(batch) // LOOKED_AT)))
    actual = _signals(search, candidate, batch, joint)
    if actual is None or not np.any(actual):
        return
    for quantity in QUANTITIES:
        if getattr(batch, quantity.name) is None or (quantity.two_sided and batch.direction is None):
            continue
        x, side = quantity.values_at_joint(batch, joint), _side(quantity, batch, joint)
        if not np.all(np.isfinite(x)) or np.ptp(x) == 0.0:
            continue
        told = _signals(search, candidate, quantity.synthetic_batch(batch, joint, x, side), joint)
        if told is not None and np.all(np.abs(told - actual) <= SAME * np.abs(actual).max(axis=0)):
            yield quantity


def _side(quantity: Follows, batch: Batch, joint: int) -> Floats:
    if quantity.two_sided and batch.direction is not None:
        return np.asarray(batch.direction[:, joint])
    return np.zeros(len(batch))


def _signals(search: SearchResult, candidate: Candidate, batch: Batch, joint: int) -> Floats | None:
    """What one unit of each parameter (N, d) moves the joint by; None of an effect that does more than move joints."""
    source = search.problem.settings.source
    values = source.library(search.problem.values)[list(candidate.columns)]
    out, start = np.zeros((len(batch), len(candidate.columns))), 0
    for effect in candidate.effects:
        count = len(effect.parameters(source.model.robot))
        if start + count > out.shape[1]:  # the data show only some of them
            return None
        local = effect.local(batch, values[start : start + count])
        if any(d.dq is None or d.xi is not None for d in local.derivatives):
            return None
        for d in local.derivatives:
            if d.joint == joint and d.dq is not None:
                out[:, start + d.parameter] += d.dq
        start += count
    return out


def _visits(search: SearchResult, joint: int) -> Visits:
    """Weighted least squares of each visit's residual along what the joint moves there."""
    problem, settings = search.problem, search.problem.settings
    moved = settings.source.joint_columns(problem.values)(joint)
    seen = np.isfinite(moved) & np.isfinite(settings.source.residual(problem.values))
    moved = np.where(seen, moved, 0.0)
    D = settings.whitening.columns(moved[:, :, None]).reshape(len(settings.used), -1)
    r = problem.raw.reshape(len(settings.used), -1)
    known = np.sum(D * D, axis=1)
    used = settings.used & (known > 0.0)
    known = np.where(used, known, 1.0)
    sigma = widening(search) / np.sqrt(known)
    return Visits(used, np.sum(D * r, axis=1) / known, sigma)


@dataclass(frozen=True)
class _Drawn:
    """A candidate at a joint over the quantity that it follows there."""

    search: SearchResult
    fit: Amounts
    candidate: Candidate
    joint: int
    follows: Follows
    visits: Visits

    @property
    def _batch(self) -> Batch:
        return self.search.problem.settings.source.batch

    def document(self, alike: set[str]) -> dict[str, Any]:
        """The curve with its 95 % band, the visits, the rival, and how far two sides are apart."""
        prismatic = self.search.problem.settings.source.model.robot.joints[self.joint].kind == "prismatic"
        x_unit, x_scale = display_unit_and_scale(self.follows.units[prismatic])
        unit, scale = display_unit_and_scale("m" if prismatic else "rad")
        grid = self._grid()
        values, covariance = self._amounts()
        width, rival = interval_width(self.search), self._rival(alike)
        sides, others, signals = [], [], []
        begin = self._axis_start
        for side in self._sides():
            S = self._signals_at_values(self.candidate, grid, side)
            signals.append(S)
            middle, half = S @ values, width * _spread(S, covariance)
            x = _round_to_seven_digits((grid - begin) * x_scale)
            ends = {
                name: _round_to_seven_digits(scale * v)
                for name, v in (("y", middle), ("low", middle - half), ("high", middle + half))
            }
            sides.append({"direction": side, "x": x, **ends})
            if rival is not None:
                other, amounts, offset, _ = rival
                y = scale * (self._signals_at_values(other, grid, side) @ amounts + offset)
                others.append({"direction": side, "x": x, "y": _round_to_seven_digits(y)})
        return {
            **self.candidate.id_and_joints(),
            "joint": self.joint + 1,
            "follows": self.follows.name,
            "x_unit": x_unit,
            "unit": unit,
            "sides": sides,
            "visits": self._dots(begin, x_scale, scale, width),
            "distance": self._distance(signals, values, covariance, scale * width, scale),
            "rival": None if rival is None else {**rival[0].id_and_joints(), "times": rival[3], "sides": others},
        }

    @property
    def _axis_start(self) -> float:
        """Where the axis begins: time is counted from the first visit."""
        return float(np.min(self.follows.values_at_joint(self._batch, self.joint))) if self.follows.name == "t" else 0.0

    def _sides(self) -> list[float | None]:
        return list(SIDES) if self.follows.two_sided else [None]

    def _grid(self) -> Floats:
        """Values (K,) of the quantity over all that was measured, so close that every wave is drawn."""
        x = self.follows.values_at_joint(self._batch, self.joint)[self.visits.used]
        low, high = float(x.min()), float(x.max())
        n = self.search.problem.settings.source.model.robot.n_joints
        times = max(
            (t for e in self.candidate.effects for j, t in e.joint_frequencies(n) if j == self.joint), default=1.0
        )
        waves = times * (high - low) / (2.0 * np.pi) if self.follows.name == "q" else 0.0
        return np.linspace(low, high, int(np.clip(A_WAVE * waves, FEWEST_POINTS, MOST_POINTS)))

    def _signals_at_values(self, candidate: Candidate, x: Floats, side: float | None) -> Floats:
        """Signals (K, d) of a candidate where the quantity is ``x (K,)``, approached from one side."""
        rows = self.follows.synthetic_batch(self._batch, self.joint, x, np.full(len(x), side or 0.0))
        made = _signals(self.search, candidate, rows, self.joint)
        assert made is not None
        return made

    def _amounts(self) -> tuple[Floats, Floats]:
        """Amplitudes (d,) of the candidate as the version stores them, and their covariance (d, d)."""
        columns = self.search.columns
        own = [columns.index(k) for k in self.candidate.columns]
        return self.fit.values[own], self.fit.covariance[np.ix_(own, own)]

    @cached_property
    def _joint_displacements(self) -> Floats:
        """What the candidate moves the joint by in every visit (V,)."""
        signals = _signals(self.search, self.candidate, self._batch, self.joint)
        assert signals is not None
        return np.asarray(signals @ self._amounts()[0])

    def _dots(self, begin: float, x_scale: float, scale: float, width: float) -> dict[str, Any]:
        """What each visit says that the effect does, half of its 95 % interval, the curve, and how many say too little."""
        visits, own = self.visits, self._joint_displacements
        clear = visits.used & (visits.sigma <= FAINT * np.median(visits.sigma[visits.used]))
        shown = np.flatnonzero(clear)
        shown = shown[:: -(-len(shown) // MOST_VISITS) or 1]
        x = (self.follows.values_at_joint(self._batch, self.joint) - begin) * x_scale
        side = _side(self.follows, self._batch, self.joint)
        return {
            "x": _round_to_seven_digits(x[shown]),
            "y": _round_to_seven_digits((scale * (own + visits.left))[shown]),
            "half": _round_to_seven_digits((scale * width * visits.sigma)[shown]),
            "curve": _round_to_seven_digits((scale * own)[shown]),
            "direction": side[shown].tolist() if self.follows.two_sided else None,
            "faint": int(visits.used.sum() - clear.sum()),
            "of": int(visits.used.sum()),
        }

    def _distance(
        self, signals: Sequence[Floats], values: Floats, covariance: Floats, width: float, scale: float
    ) -> dict[str, float] | None:
        """How far apart the two sides are on average, with its 95 % interval; None of a curve with one."""
        if len(signals) < 2:
            return None
        apart = np.mean(signals[0] - signals[1], axis=0, keepdims=True)
        middle, half = scale * float((apart @ values)[0]), width * float(_spread(apart, covariance)[0])
        return {"value": middle, "low": middle - half, "high": middle + half}

    def _rival(self, alike: set[str]) -> tuple[Candidate, Floats, float, float] | None:
        """The cause that was refused and comes nearest to the visits: its amplitudes, a zero of its own, and how many
        times the squares that it leaves are those of the one named. None without one that follows the same quantity.
        """
        visits, left = self.visits, self.visits.left / self.visits.sigma
        named = float(np.sum(left[visits.used] ** 2))
        b = (self._joint_displacements / visits.sigma + left)[visits.used]
        fits = []
        for other in self._rejected_causes(alike):
            signals = _signals(self.search, other, self._batch, self.joint)
            assert signals is not None
            A = np.column_stack([signals, np.ones(len(signals))])[visits.used] / visits.sigma[visits.used, None]
            size = np.linalg.norm(A, axis=0)
            size[size == 0.0] = 1.0
            amounts = np.linalg.lstsq(A / size, b, rcond=None)[0] / size
            fits.append((float(np.sum((b - A @ amounts) ** 2)), other, amounts))
        if not fits or named == 0.0:
            return None
        least, best, amounts = min(fits, key=lambda fit: fit[0])
        return best, amounts[:-1], float(amounts[-1]), least / named

    def _rejected_causes(self, alike: set[str]) -> Iterator[Candidate]:
        """Causes that were refused at this joint and follow the same quantity; aliases were not refused."""
        scorer, search = self.search.selector.scorer, self.search
        taken = set(search.columns)
        for other in scorer.candidates:
            at_joint = other.level == JOINT and other.joints == (self.joint,) and not other.empirical
            if at_joint and not taken & set(other.columns) and other.label not in alike:
                follows = next(_find_followed_quantities(other, self._batch, self.joint, search), None)
                if (
                    follows is not None
                    and follows.name == self.follows.name
                    and (self.follows.two_sided or not follows.two_sided)
                ):
                    yield other


def _replace_joint_column(column: Floats, joint: int, x: Floats) -> Floats:
    out = column.copy()
    out[:, joint] = x
    return out


def _spread(signals: Floats, covariance: Floats) -> Floats:
    """Standard deviations (K,) of sums of amplitudes, ``signals (K, d)`` each."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("kd,de,ke->k", signals, covariance, signals), 0.0)))


def _round_to_seven_digits(values: Floats) -> list[float]:
    """Plain numbers of seven digits: more nobody sees in a picture."""
    return [float(f"{v:.7g}") for v in values]


def measured_range(found: SearchResult, judged: Judged) -> str:
    """The range that a curve of a joint is claimed for: " over 51 deg, from -30 to 21 deg"; empty of a whole rotation."""
    claim, source = judged.claim, found.problem.settings.source
    joints = [j for j in claim.joints or () if source.model.robot.joints[j].kind == "revolute"]
    if claim.physical.id != JOINT_CURVE.id or not joints:
        return ""
    low, high = (degrees(end(source.observations.q[:, joints], axis=0)) for end in (np.min, np.max))
    span, ends = float(min(high - low)), f", from {low[0]:.0f} to {high[0]:.0f} deg"
    return "" if span >= TURN_DEG else f" over {span:.0f} deg{ends if len(joints) == 1 else ' or more each'}"
