"""All joints for a pose, against tables of arms that share nothing with Kilter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.chain import Chain
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.errors import RobotError
from kilter_core.model.closed_inverse import flange, postures, read_six_axes, solutions
from tests.clients.six_joint_arms import Arm, Floats, limits_deg

PRESETS = ("irb120", "kr6-r900", "ur10e")


@pytest.mark.parametrize("preset", PRESETS)
def test_every_posture_reaches_and_the_one_that_was_is_among_them(preset: str) -> None:
    rng = np.random.default_rng(3)
    robot, arm, bounds = robot_from_document(preset_document(preset)), Arm(preset), limits_deg(preset)
    axes = read_six_axes(robot)
    for q in np.radians(rng.uniform(np.maximum(bounds[:, 0], -179), np.minimum(bounds[:, 1], 179), (100, 6))):
        wanted = metres(arm, q)
        assert np.abs(flange(robot, q) - wanted).max() < 1e-12
        found = solutions(axes, wanted)
        for one in found:
            assert np.abs(metres(arm, one.q) - wanted).max() < 1e-10
            assert not one.singular
        apart = [np.abs(np.angle(np.exp(1j * (one.q - q)))).max() for one in found]
        assert min(apart) < 1e-7
        assert len({tuple(np.round(one.q, 6)) for one in found}) == len(found)
        assert len({(one.front, one.elbow_up, one.wrist) for one in found}) == len(found)


def metres(arm: Arm, q: Floats) -> Floats:
    T = arm.flange(np.degrees(q))
    T[:3, 3] *= 1e-3
    return T


def test_branches_are_named_by_what_they_look_like() -> None:
    """KUKA's home: the upper arm vertical, the forearm to the front; then over the shoulder, and with the elbow below."""
    robot = robot_from_document(preset_document("kr6-r900"))
    for degrees, wanted in {
        (0, -90, 90, 10, 20, 0): (True, True),
        (0, -180, 40, 10, 20, 0): (False, True),
        (0, 20, -80, 10, 20, 0): (True, False),
    }.items():
        q = np.radians(degrees)
        own = [one for one in postures(robot, flange(robot, q)) if np.abs(one.q - q).max() < 1e-6]
        assert [(one.front, one.elbow_up) for one in own] == [wanted]


def test_singular_postures_and_poses_out_of_reach_are_said() -> None:
    robot = robot_from_document(preset_document("irb120"))
    straight = postures(robot, flange(robot, np.radians([10, 20, 15, 30, 0, 40])))
    assert any(one.singular for one in straight)
    far = np.eye(4)
    far[0, 3] = 3.0
    assert postures(robot, far) == []


def test_a_third_joint_that_follows_the_second_counts_with_it() -> None:
    document = preset_document("irb120")
    coupled = robot_from_document(document)
    elements = list(coupled.chain.elements)
    own = coupled.chain.primary[2]
    follower = replace(elements[own], value=0.0, name=None, joint=1, ratio=-1.0)
    robot = replace(coupled, chain=Chain((*elements[: own + 1], follower, *elements[own + 1 :]), 6))
    q = np.radians([10, 25, -20, 30, 40, 50])
    found = postures(robot, flange(robot, q))
    assert min(np.abs(one.q - q).max() for one in found) < 1e-9
    assert np.abs(flange(robot, q) - flange(coupled, q - [0, 0, q[1], 0, 0, 0])).max() < 1e-12


@pytest.mark.parametrize("preset", ["panda", "katana450-chapter4"])
def test_an_arm_without_a_closed_form_is_refused(preset: str) -> None:
    robot = robot_from_document(preset_document(preset))
    with pytest.raises(RobotError, match=r"no closed form: .*Give joint targets"):
        postures(robot, np.eye(4))


def test_a_wrist_that_does_not_meet_is_refused() -> None:
    document = preset_document("irb120")
    rows = [row | ({"a_mm": 1.0} if k == 4 else {}) for k, row in enumerate(document["rows"])]
    with pytest.raises(RobotError, match="neither do its last three axes meet"):
        postures(robot_from_document(document | {"rows": rows}), np.eye(4))
