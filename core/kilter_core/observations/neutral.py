"""Conditions of poses that nobody has driven to yet."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from kilter_core.observations.rows import Observations


def with_neutral_conditions(rows: Observations, needs: frozenset[str]) -> Observations:
    """Rows (N,) with constants for what effects need and a pose cannot choose: at rest, 20 deg C, level, one session."""
    n = len(rows)
    made: dict[str, Any] = {
        "qd": np.zeros_like(rows.q),
        "qdd": np.zeros_like(rows.q),
        "t": np.zeros(n),
        "temperature_c": np.full(n, 20.0),
        "base_tilt_x": np.zeros(n),
        "base_tilt_y": np.zeros(n),
        "payload_kg": np.zeros(n),
        "session": np.zeros(n, dtype=np.int64),
        "direction": np.zeros_like(rows.q),
    }
    return replace(rows, **{name: made[name] for name in needs if name in made and getattr(rows, name) is None})
