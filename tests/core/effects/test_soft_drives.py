"""Drives whose stiffness is roughly known: how soft a fit expects them, in documents and in the prior."""

from __future__ import annotations

import math
from typing import Any

import pytest

from kilter_core.arm.conversions import robot_document
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.documents.parts import resolved_document, robot_from_resolved
from kilter_core.arm.presets import preset_document
from kilter_core.effects.backlash import FrictionWindup
from kilter_core.effects.compliance import AxialCompliance
from kilter_core.errors import RobotError

ARM: dict[str, Any] = {
    "name": "arm", "convention": "dh", "rows": [{"a_mm": 300, "d_mm": 100}, {"a_mm": 200}],
    "joints": [{"name": "stiff"}, {"name": "soft", "drive_stiffness_nm_rad": 25.0}],
}  # fmt: skip


def test_a_stated_stiffness_is_the_size_of_the_compliance_that_a_fit_expects() -> None:
    stiff, soft = AxialCompliance().parameters(robot_from_document(ARM))
    assert (stiff.prior_sigma, stiff.upper) == (1e-4, 1e-2)
    assert soft.prior_sigma == pytest.approx(0.04)
    assert soft.plausible(0.1)
    assert not soft.plausible(-0.01)
    assert all(soft.plausible(sign * 1e-19) for sign in (1.0, -1.0))  # a compliance that is none, to rounding
    (alone,) = AxialCompliance(joints=(1,)).parameters(robot_from_document(ARM))
    assert alone == soft
    hard = {**ARM, "joints": [{"name": "a"}, {"name": "b", "drive_stiffness_nm_rad": 1e6}]}
    assert AxialCompliance().parameters(robot_from_document(hard))[1].prior_sigma == 1e-4


def test_a_stated_wind_up_is_the_size_that_a_fit_expects() -> None:
    (usual, _), (servo, _) = (
        effect.parameters(robot_from_document(ARM))
        for effect in (FrictionWindup(), FrictionWindup(prior_sigma_rad=0.02))
    )
    assert usual.prior_sigma == pytest.approx(math.radians(0.05))
    assert servo.prior_sigma == pytest.approx(0.02)
    assert not usual.plausible(0.02)
    assert servo.plausible(0.02)
    assert servo.plausible(-0.02)


def test_it_stays_with_the_robot_and_a_robot_without_one_is_stored_as_before() -> None:
    robot = robot_from_document(ARM)
    stored = resolved_document(robot)
    assert "drive_stiffness" not in stored["joints"][0]
    assert robot_from_resolved("arm", stored).joints[1].drive_stiffness == 25.0
    assert robot_document(robot, "mdh")["joints"][1]["drive_stiffness_nm_rad"] == 25.0
    assert "drive_stiffness_nm_rad" not in robot_document(robot, "mdh")["joints"][0]


@pytest.mark.parametrize("name", ["so101", "so100", "koch", "lekiwi"])
def test_arms_of_servos_state_it(name: str) -> None:
    robot = robot_from_document({"name": "arm", **preset_document(name)})
    assert {joint.drive_stiffness for joint in robot.joints} == {33.0}


@pytest.mark.parametrize("wrong", [0.0, -3.0])
def test_what_no_drive_has_is_refused(wrong: float) -> None:
    joints = [{"name": "a"}, {"name": "b", "drive_stiffness_nm_rad": wrong}]
    with pytest.raises(RobotError, match=r"Joint 2 has drive_stiffness_nm_rad .* N m/rad above 0, of a revolute joint"):
        robot_from_document({**ARM, "joints": joints})
    slide = {
        **ARM,
        "rows": [{"type": "prismatic"}, {}],
        "joints": [{"name": "a", "drive_stiffness_nm_rad": 5.0}, {"name": "b"}],
    }
    with pytest.raises(RobotError, match="of a revolute joint"):
        robot_from_document(slide)
