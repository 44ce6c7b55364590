"""Robot documents: what they become, and how a wrong one is named."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kilter_core.arm.chain import Axis
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.errors import OptionError, RobotError

CHAIN: dict[str, Any] = {
    "convention": "chain",
    "elements": [
        {"axis": "Rz", "joint": "a"},
        {"axis": "Tx", "value": 100, "name": "reach"},
        {"axis": "Tz", "joint": "b"},
    ],
}


def chain(**changes: Any) -> dict[str, Any]:
    return {**CHAIN, **changes}


def elements(k: int, **changes: Any) -> dict[str, Any]:
    return chain(elements=[{**e, **changes} if i == k else e for i, e in enumerate(CHAIN["elements"])])


def test_units_become_metres_and_radians() -> None:
    joints = [{"name": "a", "limits_deg": [-90, 180]}, {"name": "b", "limits_mm": [0, 250], "gear_ratio": 5}]
    robot = robot_from_document(chain(joints=joints))
    np.testing.assert_allclose(robot.limits, [[-np.pi / 2, np.pi], [0.0, 0.25]])
    assert [j.kind for j in robot.joints] == ["revolute", "prismatic"]
    assert robot.joints[1].gear_ratio == 5
    assert robot.chain.elements[1].value == pytest.approx(0.1)


def test_joints_are_named_in_order_of_appearance_when_not_described() -> None:
    robot = robot_from_document(CHAIN)
    assert [j.name for j in robot.joints] == ["a", "b"]
    assert robot.limits.tolist() == [[-np.inf, np.inf]] * 2


def test_unnamed_elements_are_parameters_named_by_axis_and_place_and_fixed_ones_are_none() -> None:
    many = [{"axis": "Rz", "joint": "a"}, {"axis": "Ty", "value": 1}, {"axis": "Tx", "fixed": True, "value": 2}]
    robot = robot_from_document(chain(elements=[*many, {"axis": "Rx", "joint": "a", "ratio": 0.5}]))
    assert [e.name for e in robot.chain.elements] == ["theta_offset_1", "ty_2", None, None]
    assert robot.chain.elements[3].ratio == 0.5
    assert robot.chain.elements[1].axis is Axis.TY


def test_links_carry_mass_centre_and_inertia() -> None:
    links = [{"mass_kg": 2, "com_mm": [1, 2, 3], "inertia_kg_m2": [1, 2, 3, 4, 5, 6]}, {}]
    link, none = robot_from_document(chain(links=links)).links
    np.testing.assert_allclose(link.com, [1e-3, 2e-3, 3e-3])
    np.testing.assert_allclose(link.inertia, [[1, 4, 5], [4, 2, 6], [5, 6, 3]])
    assert none.mass == 0.0
    assert not robot_from_document(CHAIN).has_masses


BAD = {
    "convention": ({"convention": "euler"}, "convention"),
    "no convention": ({}, "convention"),
    "no elements": (chain(elements=[]), "elements"),
    "no rows": ({"convention": "dh"}, "rows"),
    "preset": ({"convention": "preset", "preset": "puma"}, "preset"),
    "axis": (elements(1, axis="Qx"), "elements[1].axis"),
    "joint of an element": (elements(2, joint="c") | {"joints": [{"name": "a"}, {"name": "b"}]}, "elements[2].joint"),
    "joint count": ({"convention": "dh", "rows": [{}, {}], "joints": [{}]}, "joints"),
    "limits": (chain(joints=[{"name": "a", "limits_deg": [10, -10]}, {"name": "b"}]), "joints[0].limits"),
    "links": (chain(links=[{}]), "links"),
    "mass": (chain(links=[{}, {"mass_kg": -1}]), "links[1].mass_kg"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_wrong_document_names_its_field(case: str) -> None:
    document, field = BAD[case]
    with pytest.raises(RobotError) as refused:
        robot_from_document(document)
    assert refused.value.context.get("field") == field
    assert refused.value.code == "robot_invalid"


def test_two_parameters_of_one_name_are_refused_by_name() -> None:
    twice = [*CHAIN["elements"], {"axis": "Ty", "name": "reach"}]
    with pytest.raises(OptionError, match="reach"):
        robot_from_document(chain(elements=twice))


def test_an_unknown_preset_lists_those_there_are() -> None:
    with pytest.raises(
        RobotError, match="katana450-chapter5, koch, kr6-r900, lekiwi, panda, so100, so101, so101-leader, ur10"
    ):
        preset_document("puma")
