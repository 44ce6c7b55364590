"""Joint parameters from inclinometers: readings made here from Pinocchio's moments and the thesis's equations."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.errors import ObservationError, RobotError
from kilter_core.plan.d_optimal import inclinometer_poses
from kilter_core.procedures.inclinometers import Log, calibration_from_inclinations, joint_parameters, weightless_joints
from tests.core.truth import Arm, Body, ur10

C, B, K = (
    math.radians(0.022),
    math.radians(0.057),
    75.0 * 9.80665 * 180.0 / math.pi,
)  # thesis tables 4.3 and 4.4, joint 3
BODIES = tuple(Body(j, 2.0 - 0.2 * j, np.array([-0.1, 0.02, 0.05])) for j in range(6))


def arm() -> Arm:
    return replace(ur10(), bodies=BODIES)


def readings(log: Log, true: Arm) -> np.ndarray:
    """What an ideal inclinometer shows: eq. 5.16 to 5.19 with the moments of Pinocchio, load sign."""
    out = np.empty(len(log.joint))
    com = np.zeros((len(out), 3)) if log.payload_com is None else log.payload_com
    for i, (q, j, axis, m, at) in enumerate(zip(log.q, log.joint, log.axis, log.payload_kg, com, strict=True)):
        eta = -true.reactions(q, payload=(float(m), at))[1][j, 3:]
        gamma = math.pi / 2 * abs(eta[0]) / (abs(eta[0]) + abs(eta[1]))
        t = math.tan(C)
        parts = [np.sign(eta[0]) * t * math.sin(gamma), np.sign(eta[1]) * t * math.cos(gamma)]
        turns = [math.atan(parts[0]), math.atan(parts[1]), np.sign(eta[2]) * B + eta[2] / K]
        out[i] = turns[axis]
    return out + 0.01 * (1 + log.axis)


def planned(joint: int, count: int = 12, com: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> tuple[Arm, Log]:
    true = arm()
    poses = inclinometer_poses(robot_from_document(true.document()), joint, count, (0.0, 2.0), payload_com=com)
    log = Log(
        q=np.array([p.q for p in poses]), joint=np.array([p.joint for p in poses]),
        axis=np.array([p.axis for p in poses]), reading=np.zeros(count),
        payload_kg=np.array([p.payload_kg for p in poses]), series=np.zeros(count, dtype=np.int64),
        payload_com=np.tile(com, (count, 1)),
    )  # fmt: skip
    return true, replace(log, reading=readings(log, true))


def test_a_payload_off_the_tool_point_is_weighed_where_it_hangs() -> None:
    true, log = planned(2, com=(0.2, -0.1, 0.25))
    robot = robot_from_document(true.document())
    right, _ = joint_parameters(robot, log)
    assert [p.value for p in right] == [pytest.approx(value, rel=1e-3) for value in (C, B, 1.0 / K)]
    wrong, _ = joint_parameters(robot, replace(log, payload_com=None))
    assert wrong[2].value is not None
    assert abs(wrong[2].value * K - 1.0) > 0.02


def test_the_planned_readings_give_the_three_parameters_within_their_sigmas() -> None:
    true, log = planned(2)
    step = log.resolution
    rounded = replace(log, reading=np.round(log.reading / step) * step)
    found, warnings = joint_parameters(robot_from_document(true.document()), rounded)
    assert [p.name for p in found] == ["clearance_3", "backlash_load_3", "compliance_3"]
    for p, truth in zip(found, (C, B, 1.0 / K), strict=True):
        assert p.value is not None
        assert p.sigma is not None
        assert abs(p.value - truth) < 3.5 * p.sigma
        assert p.sigma < 0.15 * truth
    assert not warnings
    start = calibration_from_inclinations(robot_from_document(true.document()), found)
    assert dict(zip(start.names, start.values, strict=True))["backlash_load_3"] == pytest.approx(B, rel=0.1)


def test_exact_readings_give_exact_parameters() -> None:
    true, log = planned(1)
    found, _ = joint_parameters(robot_from_document(true.document()), log)
    assert [p.value for p in found] == pytest.approx([C, B, 1.0 / K], rel=1e-5)


def test_moments_of_one_sign_and_size_cannot_tell_backlash_from_compliance() -> None:
    true, log = planned(2)
    one = replace(log, q=np.repeat(log.q[:1], 12, axis=0), payload_kg=np.zeros(12), axis=np.full(12, 2))
    found, _ = joint_parameters(robot_from_document(true.document()), replace(one, reading=readings(one, true)))
    assert all(p.value is None and p.reason for p in found)
    assert "sign" in str(found[1].reason)


def test_an_upright_axis_and_a_joint_without_gravity_are_refused() -> None:
    true, log = planned(2)
    robot = robot_from_document(true.document())
    first = replace(log, joint=np.zeros(12, dtype=np.int64), axis=np.full(12, 2))
    with pytest.raises(ObservationError, match="upright"):
        joint_parameters(robot, first)
    with pytest.raises(RobotError, match="Gravity has no moment"):
        inclinometer_poses(robot, 0)


def test_a_wrong_axis_shows_as_scatter() -> None:
    true, log = planned(2)
    wrong = replace(log, reading=np.where(np.arange(12) % 3 == 0, -log.reading, log.reading))
    _, warnings = joint_parameters(robot_from_document(true.document()), wrong)
    assert [w["code"] for w in warnings] == ["readings_scatter"]


@pytest.mark.parametrize(("true_axis", "sign"), [(1, 1.0), (0, -1.0)])
def test_an_inclinometer_on_another_axis_than_stated_is_named(true_axis: int, sign: float) -> None:
    true, log = planned(2, 16)
    stated_x = log.axis == 0
    assert stated_x.sum() >= 3
    as_mounted = replace(log, axis=np.where(stated_x, true_axis, log.axis))
    shown = readings(as_mounted, true) * np.where(stated_x, sign, 1.0)
    _, warnings = joint_parameters(robot_from_document(true.document()), replace(log, reading=shown))
    assert {w["code"] for w in warnings} == {"inclinometer_axis"}
    assert f"fit axis {'-' if sign < 0 else ''}{'xyz'[true_axis]}" in " ".join(w["message"] for w in warnings)


def test_readings_the_wrong_way_round_are_named() -> None:
    true, log = planned(2)
    found, warnings = joint_parameters(robot_from_document(true.document()), replace(log, reading=-log.reading))
    assert [w["code"] for w in warnings] == ["inclinometer_axis"]
    assert "wrong way" in warnings[0]["message"]
    assert all(p.value is not None and p.value < 0.0 for p in found)


def test_only_the_upright_joint_is_weightless() -> None:
    assert weightless_joints(robot_from_document(arm().document())) == [0]


def test_the_katana_of_the_thesis_can_be_planned() -> None:
    robot = robot_from_document(preset_document("katana450-chapter5"))
    assert len(inclinometer_poses(robot, 2, 6)) == 6
