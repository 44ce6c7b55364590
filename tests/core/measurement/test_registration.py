"""Registration: base and tool found from anywhere, without a guess."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.measurement import Measurement
from kilter_core.measurement.frames import register
from kilter_core.model import RobotModel
from tests.core.campaigns import joints, measured
from tests.core.truth import Arm, some_arm, some_pose, ur10


def drawn(arm: Arm) -> RobotModel:
    """The arm as its drawing has it: base and tool unknown."""
    nowhere = replace(arm, base=pin.SE3.Identity(), tool=pin.SE3.Identity())
    return RobotModel(robot_from_document(nowhere.document()))


def registered(
    arm: Arm, see: str, noise_m: float = 0.0, count: int = 20, **options: Any
) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    model = drawn(arm)
    measurement = Measurement.from_observations(measured(arm, joints(arm, count, rng), rng, noise_m, see))
    return register(model, model.values0(), measurement, **options)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("n", [5, 6, 7])
def test_positions_give_the_base_and_the_tool_point(n: int, seed: int) -> None:
    arm = some_arm(np.random.default_rng(seed), n)
    T_base, T_tool = registered(arm, "position")
    np.testing.assert_allclose(T_base, arm.base.homogeneous, atol=1e-6)
    np.testing.assert_allclose(T_tool[:3, 3], arm.tool.translation, atol=1e-6)
    np.testing.assert_array_equal(T_tool[:3, :3], np.eye(3))


@pytest.mark.parametrize("seed", range(4))
def test_poses_give_the_tool_s_turn_too(seed: int) -> None:
    arm = some_arm(np.random.default_rng(seed), 6)
    T_base, T_tool = registered(arm, "pose")
    np.testing.assert_allclose(T_base, arm.base.homogeneous, atol=1e-6)
    np.testing.assert_allclose(T_tool, arm.tool.homogeneous, atol=1e-6)


def test_markers_are_predicted_where_they_were_seen() -> None:
    rng = np.random.default_rng(6)
    arm = some_arm(rng, 6)
    model = drawn(arm)
    measurement = Measurement.from_observations(measured(arm, joints(arm, 15, rng), rng, see="markers"))
    T_base, T_tool = register(model, model.values0(), measurement)
    there = replace(model, T_base=T_base, T_tool=T_tool)
    residual = measurement.residual(there.predict(measurement.observations, there.values0()))
    np.testing.assert_allclose(residual.points, 0.0, atol=2e-6)


def test_a_tool_point_on_the_last_axis_is_found() -> None:
    rng = np.random.default_rng(7)
    arm = ur10(base=some_pose(rng, 4.0), tool=pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.15])))
    T_base, T_tool = registered(arm, "position", 1e-5)
    np.testing.assert_allclose(T_base[:3, 3], arm.base.translation, atol=3e-5)
    np.testing.assert_allclose(T_tool[:3, 3], arm.tool.translation, atol=3e-5)


def test_frames_that_are_not_free_stay() -> None:
    arm = some_arm(np.random.default_rng(8), 6)
    T_base, T_tool = registered(replace(arm, tool=pin.SE3.Identity()), "position", tool=False)
    np.testing.assert_allclose(T_base, arm.base.homogeneous, atol=1e-9)
    np.testing.assert_array_equal(T_tool, np.eye(4))
    T_base, T_tool = registered(replace(arm, base=pin.SE3.Identity()), "position", base=False)
    np.testing.assert_array_equal(T_base, np.eye(4))
    np.testing.assert_allclose(T_tool[:3, 3], arm.tool.translation, atol=1e-9)


@pytest.mark.parametrize("count", [3, 5])
def test_few_poses_still_give_a_start(count: int) -> None:
    arm = replace(some_arm(np.random.default_rng(9), 6), tool=pin.SE3.Identity())
    T_base, _ = registered(arm, "position", count=count)
    np.testing.assert_allclose(T_base, arm.base.homogeneous, atol=1e-6)
