"""Directions of an axis' error without a parameter: counted against models whose completeness the literature states."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.model.geometry import missing_directions

ROWS = [(0, 400, 25, -90), (0, 0, 455, 0), (-90, 0, 35, -90), (0, 420, 0, 90), (0, 0, 0, -90), (0, 80, 0, 0)]


def table(convention: str) -> dict[str, Any]:
    rows = [
        {"theta_offset_deg": theta, "d_mm": d, "a_mm": a, "alpha_deg": alpha, "type": "revolute"}
        for theta, d, a, alpha in ROWS
    ]
    return {"name": "arm", "convention": convention, "rows": rows}


def chain_of(origins: list[tuple[str, float]], named: set[str]) -> dict[str, Any]:
    """Joints about z, y and z; rotations before the second are identifiable or not."""
    before = [{"axis": axis, "value": value, "name": axis, "fixed": axis not in named} for axis, value in origins]
    lengths = [{"axis": f"T{k}", "value": 200, "name": f"{k}_2"} for k in "xyz"]
    last = [{"axis": "Rx", "value": 90, "name": "rx_3"}, {"axis": "Ry", "value": 0, "name": "ry_3"}]
    last += [{"axis": f"T{k}", "value": 150, "name": f"{k}_3"} for k in "xyz"]
    joints = [{"joint": f"j{k}", "axis": axis} for k, axis in enumerate(("Rz", "Ry", "Rz"), 1)]
    elements = [joints[0], *lengths, *before, joints[1], *last, joints[2]]
    return {"name": "arm", "convention": "chain", "elements": elements, "tool": {"x_mm": 70, "z_mm": 90}}


def test_a_six_axis_table_has_all_directions() -> None:
    assert missing_directions(robot_from_document(table("dh"))).tolist() == [0] * 6


@pytest.mark.parametrize("preset", ["ur10e", "panda", "iiwa14", "kr6-r900"])
def test_presets_of_vendors_have_all_directions(preset: str) -> None:
    assert not missing_directions(robot_from_document(preset_document(preset))).any()


@pytest.mark.parametrize(
    ("pitch", "named", "missing"),
    [
        (0.0, {"Rz", "Ry", "Rx"}, 0),
        (60.0, {"Rz", "Ry", "Rx"}, 0),
        (90.0, {"Rz", "Ry", "Rx"}, 1),  # yaw and roll are one rotation
        (-90.0, {"Rz", "Ry", "Rx"}, 1),
        (0.0, {"Rz", "Ry"}, 1),
        (0.0, {"Ry"}, 1),  # Rz is the zero of the first joint too
        (0.0, set(), 1),
    ],
)
def test_what_roll_pitch_and_yaw_lose_at_a_right_angle_is_counted(pitch: float, named: set[str], missing: int) -> None:
    document = chain_of([("Rz", 20.0), ("Ry", pitch), ("Rx", 0.0)], named)
    found = missing_directions(robot_from_document(document))
    assert (int(found[1]), int(np.delete(found, 1).sum())) == (missing, 0)
