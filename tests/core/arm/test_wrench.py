"""A wrench on the tool bends the arm: identified from rows whose truth is Pinocchio's recursion with external forces."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.observations import Observations
from tests.core.campaigns import joints
from tests.core.truth import ur10

COMPLIANCE = 2e-6  # rad per N m


def loaded(rows: int, seed: int) -> Observations:
    """Positions of a UR10 without masses that gives way to what a process does to its tool."""
    rng = np.random.default_rng(seed)
    arm = ur10()
    q, wrench = joints(arm, rows, rng), rng.normal(0.0, 80.0, (rows, 6)) * [1, 1, 1, 0.2, 0.2, 0.2]
    torque = np.array([arm.reactions(row, external=w)[0] for row, w in zip(q, wrench, strict=True)])
    position = arm.poses(q - COMPLIANCE * torque)[0] + rng.normal(0.0, 1e-5, (rows, 3))
    return Observations(q, position=position, wrench=wrench)


def test_stiffness_is_identified_from_forces_on_the_tool() -> None:
    robot = robot_from_document(ur10().document())
    options = IdentifyOptions(effects=("axial_compliance",), free=("theta_offset_*",))
    found = identify(robot, loaded(80, 1), loaded(40, 2), options)
    values = found.calibration.values[found.fit.problem.free]
    known = {name: (v, s) for name, v, s in zip(found.free_names, values, found.fit.sigma, strict=True)}
    for j in range(1, 6):
        value, sigma = known[f"compliance_{j}"]
        assert value == pytest.approx(COMPLIANCE, abs=3.5 * sigma)
        assert sigma < (0.05 * COMPLIANCE if j < 4 else COMPLIANCE)
    held = found.metrics["validation"]
    assert held["registration_only"]["rms_mm"] > 5 * held["identified"]["rms_mm"]
    assert held["identified"]["rms_mm"] < 0.02
    assert "no_load" not in {w["code"] for w in found.warnings}


def test_without_the_wrench_there_is_no_load_to_learn_from() -> None:
    rows = loaded(40, 1)
    bare = Observations(rows.q, position=rows.position)
    robot = robot_from_document(ur10().document())
    found = identify(robot, bare, None, IdentifyOptions(effects=("axial_compliance",), free=("theta_offset_*",)))
    assert "no_load" in {w["code"] for w in found.warnings}
