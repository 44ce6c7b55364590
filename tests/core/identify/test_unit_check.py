"""Wrong units of measured points, on an arm that shares no code with core."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify.plausibility.set_up_changes import unit_factor
from tests.core.campaigns import joints, measured, table_errors
from tests.core.truth import Arm, some_pose, ur10

FACTORS = {"m as mm": 1e3, "inch as mm": 25.4, "cm as mm": 10.0, "mm as m": 1e-3, "mm as inch": 1 / 25.4}


def lab(seed: int) -> tuple[Arm, Arm, np.random.Generator]:
    rng, arm = np.random.default_rng(seed), ur10()
    actual = arm.moved(table_errors(arm, rng))
    return arm, Arm(actual.steps, actual.n, some_pose(rng, 5.0), some_pose(rng, 0.4)), rng


@pytest.mark.parametrize("name", FACTORS)
@pytest.mark.parametrize("seed", range(3))
def test_the_factor_is_found(name: str, seed: int) -> None:
    arm, actual, rng = lab(seed)
    rows = measured(actual, joints(arm, 60, rng), rng, 5e-5)
    assert rows.position is not None
    found = unit_factor(robot_from_document(arm.document()), rows.q, rows.position / FACTORS[name])
    assert found == pytest.approx(FACTORS[name])


@pytest.mark.parametrize("seed", range(5))
def test_right_units_are_left_alone_whatever_the_tool_and_the_workspace(seed: int) -> None:
    arm, actual, rng = lab(seed)
    robot = robot_from_document(arm.document())
    near = joints(arm, 1, rng) + rng.normal(0.0, 0.05, (60, 6))
    wrist = np.repeat(joints(arm, 1, rng), 60, axis=0)
    wrist[:, 3:] = joints(arm, 60, rng)[:, 3:]
    for q in (joints(arm, 60, rng), near, wrist):
        rows = measured(actual, q, rng, 5e-5)
        assert rows.position is not None
        assert unit_factor(robot, q, rows.position) is None


def test_points_of_another_motion_are_no_matter_of_units() -> None:
    arm, _, rng = lab(0)
    points = rng.uniform(-1e-3, 1e-3, (60, 3))
    assert unit_factor(robot_from_document(arm.document()), joints(arm, 60, rng), points) is None
