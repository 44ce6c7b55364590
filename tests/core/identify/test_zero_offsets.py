"""Zeros of the closest table: their 95 % intervals against arms of a simulator that shares no code with what is tested."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.uncertainty.by_view import known_zeros
from kilter_core.model.table_fit import closest_table
from kilter_core.observations import Observations

ROWS = (
    (0.12, 0.03, 90.0),
    (0.0, 0.25, 0.0),
    (0.0, 0.22, 0.0),
    (0.0, 0.02, 90.0),
    (0.11, 0.0, 0.0),
)  # d, a m, alpha deg
TOOL_M = (0.03, 0.02, 0.06)
ZERO_DEG, LENGTH_M, NOISE_M = 0.8, 4e-4, 1e-4


def document() -> dict[str, object]:
    rows = [
        {"type": "revolute", "theta_offset_deg": 0, "d_mm": 1e3 * d, "a_mm": 1e3 * a, "alpha_deg": alpha}
        for d, a, alpha in ROWS
    ]
    tool = dict(zip(("x_mm", "y_mm", "z_mm"), (1e3 * x for x in TOOL_M), strict=True))
    joints = [{"name": f"j{k}", "limits_deg": [-150, 150]} for k in range(1, 6)]
    return {"name": "arm", "convention": "dh", "rows": rows, "joints": joints,
            "tool": {**tool, "rx_deg": 0, "ry_deg": 0, "rz_deg": 0}}  # fmt: skip


def points(q: np.ndarray, zeros: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Tool points (N, 3) m of an arm whose joints have these zeros (rad), its d and a longer by ``lengths (5, 2)`` m."""
    out = np.empty((len(q), 3))
    for n, angles in enumerate(q + zeros):
        T = np.eye(4)
        for angle, (d, a, alpha), (more_d, more_a) in zip(angles, ROWS, lengths, strict=True):
            c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(np.radians(alpha)), np.sin(np.radians(alpha))
            a, d = a + more_a, d + more_d
            T = T @ np.array([[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]])
        out[n] = (T @ [*TOOL_M, 1.0])[:3]
    return out


@pytest.mark.parametrize(("arms", "fewest"), [(10, 26), pytest.param(24, 62, marks=pytest.mark.slow)])
@pytest.mark.parametrize("convention", ["dh", "mdh"])
def test_intervals_of_zeros_hold_the_truth(convention: str, arms: int, fewest: int) -> None:
    robot = robot_from_document(document())
    inside, widths = [], []
    for seed in range(arms):
        rng = np.random.default_rng(seed)
        zeros = np.radians(rng.normal(0.0, ZERO_DEG, 5))
        lengths = rng.normal(0.0, LENGTH_M, (5, 2))
        lengths[1:3, 0] = 0.0  # heights of parallel axes add up
        q = rng.uniform(-1.4, 1.4, (30, 5))
        seen = points(q, zeros, lengths) + rng.normal(0.0, NOISE_M, (30, 3))
        fit = identify(robot, Observations(q, position=seen), options=IdentifyOptions(level=2))
        table = closest_table(fit.calibration, convention)
        found = known_zeros(fit.calibration, table, fit.predictive)
        assert found is not None
        off = np.array(
            [row.theta_offset - before.theta_offset for row, before in zip(table.rows, table.nominal, strict=True)]
        )
        off = np.remainder(off + np.pi, 2 * np.pi) - np.pi
        # The first joint's zero is shared with the base, the last one's with the tool: either held, or as wide as the prior.
        for k in (0, 4):
            assert found.held[k] or abs(off[k] - zeros[k]) <= found.half_width[k]
        assert not found.held[1:4].any()
        inside.append(np.abs(off - zeros)[1:4] <= found.half_width[1:4])
        widths.append(found.half_width[1:4])
    # Intervals of 95 %: fewer than 62 of 72, or all of them ten times as wide as the errors, would be a lie.
    assert np.sum(inside) >= fewest
    assert np.degrees(np.median(widths, axis=0)).max() < 0.4
    assert np.degrees(np.median(widths, axis=0))[:2].max() < 0.05
