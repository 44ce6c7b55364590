"""Measurement noise from repeats of a pose, the only estimate that owes nothing to the model.

Three things are kept apart that look alike: how shots of one visit differ (the instrument), how visits of a pose differ
(the instrument and how the arm comes to rest: what a prediction cannot know), and what is not noise at all: the two sides
a pose is approached from, another payload or session, and wrong readings.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import chdtri, fdtrc

from kilter_core.identify.fit.robust import median_scale
from kilter_core.measurement import Residual
from kilter_core.observations import Observations
from kilter_core.observations.groups import unbiased_deviations, with_directions
from kilter_core.observations.shared_rows import identical_repeats
from kilter_core.parameters import mm
from kilter_core.types import Bools, Floats, Ints

CHANCE = 0.01  # of calling one good reading of a campaign wrong
PASSES = 10
ALPHA = 0.001  # of taking chance for the two sides of a pose
FEWEST_NUMBERS = 3  # numbers a standard deviation needs to be one


@dataclass(frozen=True)
class Repeats:
    """Standard deviations (m) of a coordinate: of a reading between visits of its pose, and between shots of one visit.

    None where nothing tells. ``wrong (K,)`` are rows whose readings stand too far from their repeats to be noise, and
    ``copies (K,)`` those that repeat an earlier row to the last digit, of which nothing was read.
    """

    between: float | None
    shots: float | None
    wrong: Ints
    freedom: int = 0  # of ``between``
    copies: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @staticmethod
    def from_observations(observations: Observations, left: Residual | None = None) -> Repeats:
        """Read the repeats; from what a fit ``left`` of them where it is known, so that readings need not be equal.

        Where no column says from which side a pose was approached, the order of the rows says which way each joint moved
        last: visits are compared side by side as soon as those differ by less.
        """
        flat = _points(observations, left)
        if flat is None:
            return Repeats(None, None, np.zeros(0, dtype=np.int64))
        again = identical_repeats(observations)
        flat = np.where(again[:, None], np.nan, flat)
        found = replace(_read(observations, flat), copies=np.flatnonzero(again))
        if observations.stated_direction is not None or found.between is None:
            return found
        sided = _read(replace(with_directions(observations), directions_derived=False), flat)
        return replace(sided, copies=found.copies) if _clearly_less(sided, found) else found

    def to_document(self) -> dict[str, Any]:
        """JSON-able, mm."""
        return {
            "between_visits_mm": None if self.between is None else mm(self.between),
            "between_shots_mm": None if self.shots is None else mm(self.shots),
            "wrong_rows": len(self.wrong),
        }


def _read(observations: Observations, flat: Floats) -> Repeats:
    condition, visit = observations.conditions(), observations.visits()
    rows = np.flatnonzero(~np.isnan(flat).any(axis=1))
    shots, _, off = _pooled_sigma(flat[rows], visit[rows])
    wrong = [rows[off]]
    rows = rows[~off]
    _, first, place, count = np.unique(visit[rows], return_index=True, return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(place, weights=c) for c in flat[rows].T], axis=1) / count[:, None]
    spread, freedom, off = _pooled_sigma(mean, condition[rows][first])
    wrong.append(rows[off[place]])
    between = (
        None
        if spread is None
        else float(np.hypot(spread, (shots or 0.0) * np.sqrt(_averaged_variance_share(count[~off]))))
    )
    return Repeats(between, shots, np.sort(np.concatenate(wrong)), freedom)


def with_sides_of_repeats(rows: Observations) -> Observations:
    """Return rows whose visits of a pose repeat each other from one side only, where those clearly differ by less.

    Derived directions may be of an order in which nobody measured: they part no repeats unless the repeats show them.
    """
    flat = _points(rows, None)
    if not rows.directions_derived or flat is None:
        return rows
    sided = replace(rows, directions_derived=False)
    return sided if _clearly_less(_read(sided, flat), _read(rows, flat)) else rows


def _clearly_less(sided: Repeats, found: Repeats) -> bool:
    """Whether visits from one side differ by less than visits from any (F test on what the sides add)."""
    if sided.between is None or found.between is None or not FEWEST_NUMBERS <= sided.freedom < found.freedom:
        return False
    within = sided.freedom * sided.between**2
    more, extra = found.freedom * found.between**2 - within, found.freedom - sided.freedom
    return within > 0.0 and bool(fdtrc(extra, sided.freedom, more / extra / sided.between**2) < ALPHA)


def repeat_sigma(observations: Observations) -> float | None:
    """Standard deviation (m) of a coordinate between visits of a pose, None where no pose was visited again.

    Markers count as their own points; rows with an unseen marker are left out.
    """
    return Repeats.from_observations(observations).between


def _points(observations: Observations, left: Residual | None) -> Floats | None:
    points = observations.markers if observations.markers is not None else observations.position
    if left is not None and len(left.points) == len(observations) and left.points.shape[2] == 3:
        points = left.points
    return None if points is None else points.reshape(len(points), -1)


def _averaged_variance_share(count: Ints) -> float:
    """Share of the variance of a shot that the mean of a visit has lost."""
    return float(np.mean(1.0 - 1.0 / count)) if len(count) else 0.0


def pooled_columns(values: Floats, group: Ints) -> float | None:
    """Standard deviation of a number (N, C) within groups, each column by itself, NaN where nothing was read."""
    square, freedom = 0.0, 0
    for column in values.T:
        seen = ~np.isnan(column)
        spread, free, _ = _pooled_sigma(column[seen, None], group[seen])
        if spread is not None:
            square, freedom = square + free * spread**2, freedom + free
    return float(np.sqrt(square / freedom)) if freedom else None


def _pooled_sigma(values: Floats, group: Ints) -> tuple[float | None, int, Bools]:
    """Standard deviation of a coordinate within groups, its freedom, and which values (N,) are too far off to count."""
    kept = np.ones(len(values), dtype=bool)
    width = values.shape[1] if len(values) else 1
    limit = float(np.sqrt(chdtri(width, CHANCE / max(len(values), 1))))
    for _ in range(PASSES):
        off, free = unbiased_deviations(values, group, kept)
        count = np.bincount(group[kept], minlength=int(group.max(initial=-1)) + 1)
        size = np.where(kept & (count[group] > 1), np.linalg.norm(off, axis=1), 0.0)
        told = size[kept & (count[group] > 1)]
        if not len(told):
            break
        far = size > limit * median_scale(told, width)
        if not far.any() or median_scale(told, width) == 0.0:
            break
        # Of a group the worst goes first: it drags the mean that makes the others look wrong.
        worst = np.zeros(len(count))
        np.maximum.at(worst, group, size)
        kept &= ~(far & (size >= worst[group] * (1.0 - 1e-9)))
    count = np.bincount(group[kept], minlength=int(group.max(initial=-1)) + 1)
    freedom = int(np.sum(np.maximum(count - 1, 0))) * width
    if freedom < FEWEST_NUMBERS:
        return None, freedom, ~kept
    square = (off[kept] / free[kept]) ** 2
    return float(np.sqrt(square[count[group[kept]] > 1].sum() / freedom)), freedom, ~kept
