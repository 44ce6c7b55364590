"""Visits: rows taken without leaving a pose, averaged, so that what remains is independent from one to the next."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.observations import Observations
from core.transforms import nearest_rotation

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

PAUSE = 0.5  # of the usual time between poses, above which a repeat was approached anew


@dataclass(frozen=True)
class Visits:
    """Averaged rows. ``visit (N,)`` is the visit of each row, ``count (V,)`` its rows, ``pose (V,)`` its pose,
    ``condition (V,)`` numbers pose together with direction, load and session: visits that should agree.
    """

    observations: Observations
    visit: Ints
    count: Ints
    pose: Ints
    condition: Ints

    def __len__(self) -> int:
        return len(self.count)


def visits_of(rows: Observations) -> Visits:
    """Group the rows of one pose that follow each other under the same conditions, and average each group."""
    pose = rows.pose_groups()
    condition = _conditions(rows, pose)
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (condition[1:] != condition[:-1]) | _left(rows, condition)
    visit = np.cumsum(new).astype(np.int64) - 1
    first = np.flatnonzero(new)
    count = np.bincount(visit)
    averaged = rows.select(first) if count.max() == 1 else _averaged(rows, visit, first, count)
    return Visits(averaged, visit, count, pose[first], condition[first])


def _left(rows: Observations, condition: Ints) -> NDArray[np.bool_]:
    """Where (N - 1,) the arm left the pose and came back although nothing else changed: the clock shows a long pause."""
    if rows.t is None:
        return np.zeros(max(len(rows) - 1, 0), dtype=bool)
    pause = np.abs(np.diff(rows.t))
    changed = condition[1:] != condition[:-1]
    if not changed.any() or changed.all():
        return np.zeros(len(pause), dtype=bool)
    return np.asarray(pause > PAUSE * np.median(pause[changed]))


def _conditions(rows: Observations, pose: Ints) -> Ints:
    columns = [pose.astype(np.float64)[:, None]]
    if rows.direction is not None:
        columns.append(rows.direction)
    columns += [c[:, None].astype(np.float64) for c in (rows.payload_kg, rows.session) if c is not None]
    return np.unique(np.hstack(columns), axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _averaged(rows: Observations, visit: Ints, first: Ints, count: Ints) -> Observations:
    out = rows.select(first)
    plain = ("q", "position", "markers", "link_q", "qd", "qdd", "tau", "t", "temperature_c")
    made: dict[str, Any] = {
        name: _mean(value, visit, count) for name in plain if (value := getattr(rows, name)) is not None
    }
    if rows.rotation is not None:
        mean = _mean(rows.rotation, visit, count)
        made["rotation"] = np.stack([nearest_rotation(R) if k > 1 else R for R, k in zip(mean, count, strict=True)])
    if rows.sigma is not None:
        made["sigma"] = np.sqrt(_mean(rows.sigma**2, visit, count) / count[:, None])
    return replace(out, **made)


def _mean(values: Floats, visit: Ints, count: Ints) -> Floats:
    """Mean of each visit; an unseen marker stays unseen only when every row of the visit misses it."""
    flat = values.reshape(len(values), -1)
    seen = ~np.isnan(flat)
    sums = np.zeros((len(count), flat.shape[1]))
    hits = np.zeros_like(sums)
    np.add.at(sums, visit, np.where(seen, flat, 0.0))
    np.add.at(hits, visit, seen)
    with np.errstate(invalid="ignore"):
        mean = np.where(hits > 0, sums / np.where(hits > 0, hits, 1.0), np.nan)
    return np.asarray(mean.reshape(len(count), *values.shape[1:]))
