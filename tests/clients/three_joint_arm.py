"""An arm with a turning column and two links in its plane, and its kinematics, which share nothing with Kilter's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
LENGTHS_MM = (400.0, 300.0, 200.0)


def tip_mm(q_deg: Floats, lengths_mm: tuple[float, float, float] = LENGTHS_MM) -> Floats:
    """Tool point in the arm's own base frame."""
    q1, q2, q3 = np.radians(q_deg.T)
    out = lengths_mm[1] * np.cos(q2) + lengths_mm[2] * np.cos(q2 + q3)
    up = lengths_mm[0] + lengths_mm[1] * np.sin(q2) + lengths_mm[2] * np.sin(q2 + q3)
    return np.stack([out * np.cos(q1), out * np.sin(q1), up], axis=1)


def arm(name: str) -> dict[str, object]:
    """The arm as DH table."""
    rows = [(90.0, 0.0, LENGTHS_MM[0]), (0.0, LENGTHS_MM[1], 0.0), (0.0, LENGTHS_MM[2], 0.0)]
    return {
        "name": name,
        "convention": "dh",
        "joints": [{"name": f"j{k}", "limits_deg": [-170, 170]} for k in (1, 2, 3)],
        "rows": [
            {"type": "revolute", "alpha_deg": alpha, "a_mm": a, "theta_offset_deg": 0, "d_mm": d}
            for alpha, a, d in rows
        ],
    }
