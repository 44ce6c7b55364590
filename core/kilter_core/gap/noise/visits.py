"""Visits: rows taken without leaving a pose, averaged, so that what remains is independent from one to the next."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.identify.rows.noise import with_sides_of_repeats
from kilter_core.observations import Observations
from kilter_core.observations.repeats import group_means
from kilter_core.transforms import nearest_rotation
from kilter_core.types import Bools, Ints


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


def average_visits(rows: Observations) -> Visits:
    """Average the rows of each visit, and number visits by their first rows."""
    rows = with_sides_of_repeats(rows)
    first, visit, count = _number_runs(rows.visits())
    averaged = rows.select(first) if count.max() == 1 else _average_rows(rows, visit, first, count)
    return Visits(averaged, visit, count, rows.pose_groups()[first], rows.conditions()[first])


def isolate_unused_visits(condition: Ints, used: Bools) -> Ints:
    """Conditions (V,) where visits that are not ``used (V,)`` repeat none."""
    return np.where(used, condition, condition.max() + 1 + np.arange(len(used)))


def _number_runs(run: Ints) -> tuple[Ints, Ints, Ints]:
    """First row (V,) of each run, the number (N,) of its run of every row in the order of the rows, and its rows (V,)."""
    _, first, inverse, count = np.unique(run, return_index=True, return_inverse=True, return_counts=True)
    order = np.argsort(first, kind="stable")
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    return first[order].astype(np.int64), place[inverse.reshape(-1)], count[order].astype(np.int64)


def _average_rows(rows: Observations, visit: Ints, first: Ints, count: Ints) -> Observations:
    out = rows.select(first)
    plain = (
        "q",
        "position",
        "markers",
        "link_q",
        "tilt",
        "qd",
        "qdd",
        "tau",
        "t",
        "temperature_c",
        "bar_length",
        "base_tilt_x",
        "base_tilt_y",
        "link_mass",
        "link_wrench",
        "command",
    )
    made: dict[str, Any] = {
        name: group_means(value, visit) for name in plain if (value := getattr(rows, name)) is not None
    }
    if rows.rotation is not None:
        mean = group_means(rows.rotation, visit)
        made["rotation"] = np.stack([nearest_rotation(R) if k > 1 else R for R, k in zip(mean, count, strict=True)])
    if rows.sigma is not None:
        made["sigma"] = np.sqrt(group_means(rows.sigma**2, visit) / count[:, None])
    return replace(out, **made)
