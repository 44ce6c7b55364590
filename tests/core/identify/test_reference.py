"""In which frames a correction works: the robot's own, the registration's, or those of the version a fit starts from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import IdentifyOptions, Prior, identify
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.truth import Arm, ur10

TOOL = pin.SE3(np.eye(3), np.array([0.05, 0.0, 0.1]))
FAR = pin.SE3(pin.exp3(np.array([0.2, -0.3, 0.5])), np.array([1.5, -1.2, 0.4]))
NOISE_M = 1e-5
ERRORS = {"a_2": 4e-4, "theta_offset_3": 1e-3, "d_5": -3e-4, "alpha_4": 8e-4}
GEOMETRY = IdentifyOptions(level=2)


def arm(base: pin.SE3 = FAR, tool: pin.SE3 = TOOL) -> Arm:
    return replace(ur10(tool=tool).moved(ERRORS), base=base)


def rows(of: Arm, seed: int, count: int = 60, turns: bool = False) -> Observations:
    rng = np.random.default_rng(seed)
    q = rng.uniform(-2.0, 2.0, (count, 6))
    p, R = of.poses(q)
    return Observations(q, position=p + NOISE_M * rng.standard_normal(p.shape), rotation=R if turns else None)


@pytest.fixture(scope="module")
def robot():
    return robot_from_document(ur10(tool=TOOL).document())


@pytest.fixture(scope="module")
def first(robot):
    return identify(robot, rows(arm(), 1), options=GEOMETRY).calibration


def apart(a: Calibration, b: Calibration) -> float:
    return max(np.abs(a.wanted_base - b.wanted_base).max(), np.abs(a.wanted_tool - b.wanted_tool).max())


def test_a_version_from_another_keeps_its_frames_where_the_tracker_stands(robot, first):
    again = identify(robot, rows(arm(), 2), options=GEOMETRY, start=first).calibration
    assert apart(again, first) == 0.0
    alone = identify(robot, rows(arm(), 2), options=GEOMETRY).calibration
    assert apart(alone, first) > 1e-6  # other poses, another registration: corrected paths would jump


@pytest.mark.parametrize("moved_m", [0.003, 0.5])
def test_a_tracker_set_up_anew_is_registered_anew(robot, first, moved_m):
    elsewhere = rows(arm(base=pin.SE3(np.eye(3), np.array([0.0, moved_m, 0.0])) * FAR), 3)
    found = identify(robot, elsewhere, options=GEOMETRY, start=first).calibration
    alone = identify(robot, elsewhere, options=GEOMETRY).calibration
    assert apart(found, alone) == 0.0
    assert abs(np.linalg.norm(found.wanted_base[:3, 3] - first.wanted_base[:3, 3]) - moved_m) < 1e-3


def test_another_tool_is_registered_anew(robot, first):
    bolted = TOOL * pin.SE3(np.eye(3), np.array([0.0, 0.02, 0.0]))
    found = identify(robot, rows(arm(tool=bolted), 4), options=GEOMETRY, start=first).calibration
    assert np.linalg.norm(found.wanted_tool[:3, 3] - bolted.translation) < 1e-3


def test_a_held_frame_is_that_of_the_start(robot, first):
    held = replace(GEOMETRY, base="fixed")
    found = identify(robot, rows(arm(), 5), options=held, start=first).calibration
    assert np.array_equal(found.wanted_base, first.wanted_base)
    # Versions without wanted frames were made of joint data, or before they were kept: their base is no place to go to.
    bare = replace(first, wanted_base=None, wanted_tool=None)
    found = identify(robot, rows(arm(), 5), options=held, start=bare).calibration
    assert np.linalg.norm(found.wanted_base[:3, 3] - FAR.translation) < 2e-3


def test_what_is_asked_for_goes_before_the_start(robot, first):
    found = identify(robot, rows(arm(), 6), options=replace(GEOMETRY, reference="robot"), start=first).calibration
    assert np.array_equal(found.wanted_base, robot.T_base)
    found = identify(robot, rows(arm(), 6), options=replace(GEOMETRY, reference="registration"), start=first)
    assert 0.0 < apart(found.calibration, first) < 2e-3


def test_a_filter_that_goes_on_keeps_the_frames_with_two_poses(robot):
    began = identify(robot, rows(arm(), 1), options=GEOMETRY)
    prior = Prior(began.free_names, began.covariance)
    on = replace(GEOMETRY, method="kalman", noise_mm=NOISE_M * 1e3)
    found = identify(robot, rows(arm(), 7, count=2), options=on, start=began.calibration, prior=prior)
    assert apart(found.calibration, began.calibration) == 0.0


def test_a_measured_tool_turned_by_a_right_angle_is_not_the_robots_own(robot):
    quarter = TOOL * pin.SE3(pin.exp3(np.array([0.0, 0.0, np.pi / 2])), np.zeros(3))
    found = identify(robot, rows(arm(tool=quarter), 8, turns=True), options=GEOMETRY)
    assert found.to_document()["reference"]["tool"] == "registration"
    assert np.abs(found.calibration.wanted_tool[:3, :3] - quarter.rotation).max() < 0.01
