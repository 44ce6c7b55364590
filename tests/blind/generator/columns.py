"""Visits and readings as the columns of Kilter's contract, one row per reading in the order of time."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.visits import Visits

Floats = NDArray[np.float64]


def columns_of(
    visits: Visits, readings: Floats, told_kg: Floats, shot_gap_s: float
) -> tuple[dict[str, NDArray[Any]], NDArray[np.int64]]:
    """Columns (name -> array) of ``readings (V, repeats, 3)`` m, and their order among the readings."""
    repeats = readings.shape[1]

    def rows(x: NDArray[Any]) -> NDArray[Any]:
        return np.repeat(x, repeats, axis=0)

    columns: dict[str, NDArray[Any]] = {}
    q, direction = rows(np.degrees(visits.q)), rows(visits.direction)
    for i in range(q.shape[1]):
        columns[f"q{i + 1}_deg"] = q[:, i]
    for i, axis in enumerate("xyz"):
        columns[f"{axis}_mm"] = readings.reshape(-1, 3)[:, i] * 1e3
    for i in range(q.shape[1]):
        columns[f"dir{i + 1}"] = direction[:, i].astype(np.int64)
    columns["t_s"] = rows(visits.t_s) + np.tile(np.arange(repeats), len(visits)) * shot_gap_s
    columns["payload_kg"], columns["temperature_c"] = rows(told_kg), rows(visits.temperature_c)
    columns["session"], columns["pose_id"] = rows(visits.session), rows(visits.pose)
    order = np.argsort(columns["t_s"], kind="stable")
    return {name: column[order] for name, column in columns.items()}, order
