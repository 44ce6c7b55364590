from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from kilter_core.arm.conversions import robot_document
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.documents.parts import resolved_document, robot_from_resolved
from kilter_core.arm.presets import preset_document, preset_names
from kilter_core.arm.robot import Robot
from kilter_core.model import Calibration
from kilter_core.observations import Observations

LIFT: dict[str, Any] = {
    "name": "lift",
    "convention": "chain",
    "joints": [{"name": "up", "limits_mm": [0, 333.3]}, {"name": "round", "gear_ratio": 101}],
    "elements": [
        {"axis": "Rz", "value": 33.3, "fixed": True},
        {"joint": "up", "axis": "Tz", "ratio": -1.0},
        {"name": "turned", "axis": "Ry", "value": 0.1},
        {"joint": "round", "axis": "Rx", "value": 1e-7},
        {"axis": "Tx", "value": 123.456789, "joint": "round", "ratio": 0.5},
    ],
    "links": [
        {
            "mass_kg": 1.1,
            "com_mm": [0.1, 2, 3],
            "inertia_kg_m2": [0.1, 0.2, 0.3, 0.01, 0.02, 0.03],
            "com_sigma_mm": 3.3,
        },
        {"mass_kg": 0.7, "mass_sigma_kg": 0.07},
    ],
    "tool": {"x_mm": 0.1, "ry_deg": 12.3},
    "base": {"z_mm": 777.7, "rz_deg": 0.1},
    "gravity_m_s2": [0.1, 0, -9.80665],
    "payload_sigma": {"mass_percent": 3, "com_mm": 7},
}


def robots() -> list[Any]:
    found = [pytest.param(robot_from_document(preset_document(name)), id=name) for name in preset_names()]
    found.append(pytest.param(robot_from_document(LIFT), id="lift"))
    ur10 = robot_from_document(preset_document("ur10"))
    found += [
        pytest.param(robot_from_document(robot_document(ur10, convention)), id=convention)
        for convention in ("chain", "mdh", "poe", "mcpc", "s_model")
    ]
    return found


@pytest.mark.parametrize("robot", robots())
def test_a_robot_comes_back_bit_by_bit_through_json(robot: Robot) -> None:
    document = json.loads(json.dumps(resolved_document(robot)))
    again = robot_from_resolved(robot.name, document)
    assert (again.name, again.joints, again.chain) == (robot.name, robot.joints, robot.chain)
    assert again.payload_sigma == robot.payload_sigma
    assert len(again.links) == len(robot.links)
    for name in ("gravity", "T_base", "T_tool", "limits"):
        assert np.array_equal(getattr(again, name), getattr(robot, name)), name
    for mine, other in zip(again.links, robot.links, strict=True):
        assert (mine.element, mine.mass, mine.mass_sigma, mine.com_sigma) == (
            other.element, other.mass, other.mass_sigma, other.com_sigma,
        )  # fmt: skip
        assert np.array_equal(mine.com, other.com)
        assert np.array_equal(mine.inertia, other.inertia)
    q = np.random.default_rng(1).uniform(-0.3, 0.3, (20, robot.n_joints))
    here, there = (Calibration.nominal(arm).predict(Observations(q)) for arm in (again, robot))
    assert np.array_equal(here.position, there.position)
    assert np.array_equal(here.rotation, there.rotation)
    assert resolved_document(again) == document


def test_the_name_of_a_robot_is_no_part_of_the_arm() -> None:
    one, other = (resolved_document(robot_from_document({**LIFT, "name": name})) for name in ("one", "other"))
    assert one == other
