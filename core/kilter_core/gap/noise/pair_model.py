"""Noise from visits of one pose from other sides or under other loads: what is left of their differences.

Geometry and every other error of a pose are the same for all its visits, so these differ by noise, by drift, and by what
sides and loads do. The library's candidates of sides and loads are fitted to the differences, and what they leave is noise
as that of repeats is. Too few differences to fit them leave a bound: the noise is this at most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kilter_core.gap.noise.drift import scalar_blocks, visit_clocks
from kilter_core.gap.noise.shared_drift import SCALARS_BESIDE_DRIFT, moments_and_motions
from kilter_core.gap.noise.variogram import SPIKE
from kilter_core.gap.noise.visits import Visits, isolate_unused_visits
from kilter_core.observations.groups import subtract_group_means
from kilter_core.types import Bools, Floats, Ints

PASSES = 4  # selections without the visits that are spikes for the one before
SEEN = 1e-6  # of a column's length: less of it between visits is rounding


@dataclass(frozen=True)
class PairModel:
    """Candidates of sides and loads by which visits of one pose differ.

    ``pose (V,)`` numbers what revisits share: pose, session and contact. ``W (V, m, Q)`` are derivatives of what was measured
    by the library ``columns (Q,)``; ``candidates`` are places of these that are fitted together,
    and ``whole`` says that they are all that the library has.
    """

    pose: Ints
    W: Floats
    columns: Ints
    candidates: tuple[tuple[int, ...], ...]
    visits: Visits
    points: Floats | None
    lengths: int | None
    whole: bool = True

    def fit_sides_and_loads(self, mean: Floats, used: Bools) -> tuple[Floats, int]:
        """What sides and loads do to the visits (V, m), by the candidates that their differences show; and how many
        numbers were fitted for it.
        """
        kept = used & (np.bincount(self.pose[used], minlength=int(self.pose.max()) + 1)[self.pose] > 1)
        size = mean.shape[1]
        for _ in range(PASSES):
            scale = self._scales(mean, kept)
            y = self._differences(mean[:, :, None], kept, scale)[:, 0]
            X = self._differences(np.concatenate([self.W, self._drift], axis=2), kept, scale)
            chosen = _select_columns(X, y, self._candidates_with_drift, len(y) - size * len(np.unique(self.pose[kept])))
            amounts = np.linalg.lstsq(X[:, chosen], y, rcond=SEEN)[0]
            left = np.abs((y - X[:, chosen] @ amounts).reshape(-1, size)).max(axis=1)
            near = left <= SPIKE * max(float(np.median(left)), SEEN)
            if near.all():
                break
            kept[np.flatnonzero(kept)[~near]] = False
        own = [k for k in chosen if k < len(self.columns)]
        return self.W[:, :, own] @ amounts[[chosen.index(k) for k in own]], len(own)

    def separable(self, used: Bools) -> bool:
        """Whether enough is left of the differences when every candidate of sides and loads is fitted to them."""
        size = self.W.shape[1]
        X = self._differences(self.W, used, np.ones(size))
        norms = np.linalg.norm(X, axis=0)
        rank = np.linalg.matrix_rank(X / np.where(norms > 0.0, norms, 1.0), tol=np.sqrt(SEEN)) if X.size else 0
        free = size * (int(used.sum()) - len(np.unique(self.pose[used])))
        return bool(self.whole and free - rank >= SCALARS_BESIDE_DRIFT)

    def _differences(self, values: Floats, kept: Bools, scale: Floats) -> Floats:
        """Rows (R, K) of values (V, m, K) less the mean of their pose, in units of ``scale (m,)``."""
        made = subtract_group_means(values, isolate_unused_visits(self.pose, kept))[kept] / scale[:, None]
        return np.asarray(made.reshape(-1, values.shape[2]))

    def _scales(self, mean: Floats, kept: Bools) -> Floats:
        """A usual difference (m,) of each number's kind: lengths and rotations are compared in these."""
        away, out = (
            np.abs(subtract_group_means(mean, isolate_unused_visits(self.pose, kept))[kept]),
            np.ones(mean.shape[1]),
        )
        for block in scalar_blocks(mean.shape[1], self.lengths):
            out[block] = max(float(np.median(away[:, block], axis=None)), 1e-12)
        return out

    @cached_property
    def _drift(self) -> Floats:
        """Columns (V, m, K) of a drift that all visits share, so that it is not taken for sides or loads."""
        return moments_and_motions(self.pose, visit_clocks(self.visits)[0], self.points, self.W.shape[1])

    @cached_property
    def _candidates_with_drift(self) -> tuple[tuple[int, ...], ...]:
        """The candidates, and the drift along each clock."""
        start, count = len(self.columns), self._drift.shape[2]
        return (*self.candidates, *((tuple(range(start, start + count)),) if count else ()))


def _select_columns(X: Floats, y: Floats, candidates: Sequence[tuple[int, ...]], free: int) -> list[int]:
    """Columns (R, K) that rows ``y (R,)`` of so much freedom show, the candidate that gains most first.

    A candidate pays for its numbers as by Schwarz, and for having been chosen among so many.
    """
    norms = np.linalg.norm(X, axis=0)
    X = X / np.where(norms > 0.0, norms, 1.0)
    chosen: list[int] = []
    left, r = X.copy(), y.copy()
    paid = 2.0 * np.log(max(len(candidates), 1))
    while True:
        best, gain = None, 0.0
        for columns in candidates:
            u = _basis(left[:, [k for k in columns if k not in chosen]])
            rest, d = free - len(chosen), u.shape[1]
            if not d or rest - d < SCALARS_BESIDE_DRIFT:
                continue
            yy = float(r @ r)
            after = max(yy - float(np.sum((u.T @ r) ** 2)), SEEN**2 * yy)
            value = rest * np.log(yy / after) - d * np.log(rest) - paid if yy > 0.0 else 0.0
            if value > gain:
                best, gain, basis = columns, value, u
        if best is None:
            return chosen
        chosen += [k for k in best if k not in chosen]
        left, r = left - basis @ (basis.T @ left), r - basis @ (basis.T @ r)


def _basis(columns: Floats) -> Floats:
    """Orthonormal basis (R, d) of unit columns (R, K) of which something else was taken out."""
    if not columns.shape[1]:
        return columns
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(u[:, s > np.sqrt(SEEN)])
