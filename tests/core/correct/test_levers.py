"""How far a joint moves the tool at most, against Pinocchio's Jacobian."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.correct.correction_needs import levers
from kilter_core.correct.program import compile_program
from kilter_core.model import Calibration
from tests.core.truth import Arm, Step, some_arm, ur10


def levers_of(arm: Arm) -> np.ndarray:
    return levers(compile_program(Calibration.nominal(robot_from_document(arm.document()))))


def largest(arm: Arm, rng: np.random.Generator, count: int = 400) -> np.ndarray:
    """The most that Pinocchio finds at random poses."""
    J = arm.joint_jacobians(rng.uniform(*arm.limits, (count, arm.n)))
    return np.asarray(np.linalg.norm(J[:, :3], axis=1).max(axis=0))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("prismatic", "coupled"), [(False, False), (True, False), (False, True), (True, True)])
def test_no_pose_moves_the_tool_further(seed: int, prismatic: bool, coupled: bool) -> None:
    rng = np.random.default_rng(seed)
    arm = some_arm(rng, 6, prismatic=prismatic, coupled=coupled)
    found, bound = largest(arm, rng), levers_of(arm)
    assert np.all(found <= bound * (1.0 + 1e-9))
    assert np.all(bound < 10.0 + found)


def test_a_ur10_has_the_levers_of_its_table() -> None:
    found, bound = largest(ur10(), np.random.default_rng(1), 20_000), levers_of(ur10())
    assert np.all(found <= bound * (1.0 + 1e-9))
    assert np.all(bound < 1.45 * found + 0.01)  # not far from what poses reach
    assert bound[5] == pytest.approx(0.0, abs=1e-12)  # the tool is on the last axis
    assert bound[4] == pytest.approx(0.0922)


def test_what_runs_along_parallel_axes_does_not_count() -> None:
    """A SCARA: its heights and its prismatic joint move no joint's tool sideways."""
    steps = (
        Step("tz", 0.4), Step("rz", 0.0, 0), Step("tx", 0.3), Step("tz", 0.1), Step("rz", 0.0, 1), Step("tx", 0.2),
        Step("tz", -0.5, 2), Step("tz", -0.25), Step("rz", 0.0, 3), Step("tx", 0.01),
    )  # fmt: skip
    arm = Arm(tuple(s if s.name else Step(s.axis, s.value, s.joint, s.ratio, f"p{k}") for k, s in enumerate(steps)), 4)
    assert levers_of(arm) == pytest.approx([0.51, 0.21, 1.0, 0.01])
