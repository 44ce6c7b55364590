"""Inverse dynamics as a matrix: against Pinocchio's recursion of Newton and Euler, of any arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Link
from kilter_core.motion.regressor import base_columns, rigid_regressor, stated_numbers
from tests.core.arm.test_moments import KINDS, arm_robot
from tests.core.palletiser import said
from tests.corrector.test_mimic_bodies import coupled


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 100_000), n=st.integers(1, 8), kind=st.sampled_from(sorted(KINDS)))
def test_torques_of_any_arm_are_pinocchio_s(seed: int, n: int, kind: str) -> None:
    arm, robot, rng = arm_robot(kind, n, seed)
    q, qd, qdd = (rng.uniform(-1.0, 1.0, (3, n)) for _ in range(3))
    torques = rigid_regressor(robot, q, qd, qdd) @ stated_numbers(robot)
    for k in range(3):
        np.testing.assert_allclose(torques[k], arm.reactions(q[k], qd[k], qdd[k])[0], atol=1e-10, rtol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_base_parameters_say_all_that_the_torques_say(seed: int) -> None:
    _, robot, rng = arm_robot("revolute", 6, seed)
    kept = base_columns(robot)
    q, qd, qdd = (rng.uniform(-1.0, 1.0, (20, 6)) for _ in range(3))
    Y = rigid_regressor(robot, q, qd, qdd)
    torques = (Y @ rng.normal(size=Y.shape[2])).ravel()
    base, *_ = np.linalg.lstsq(Y[:, :, kept].reshape(len(torques), -1), torques, rcond=None)
    np.testing.assert_allclose(Y[:, :, kept].reshape(len(torques), -1) @ base, torques, atol=1e-9)


def test_an_upright_elbow_arm_has_36_base_parameters() -> None:
    """Of a PUMA 560: Gautier and Khalil (1990), with an inertia of the first motor that joins that of its link."""
    rows = [
        (0.0, 0.0, 0.0),
        (0.0, 0.0, -np.pi / 2),
        (0.149, 0.432, 0.0),
        (0.433, 0.02, -np.pi / 2),
        (0.0, 0.0, np.pi / 2),
    ]
    elements = []
    for j, (d, a, alpha) in enumerate([*rows, (0.0, 0.0, -np.pi / 2)]):
        elements += [{"axis": "Tx", "value": 1e3 * a}, {"axis": "Rx", "value": np.degrees(alpha)}]
        elements += [{"axis": "Tz", "value": 1e3 * d}, {"axis": "Rz", "value": 0.0, "joint": f"j{j + 1}"}]
    joints = [{"name": f"j{j + 1}"} for j in range(6)]
    robot = robot_from_document({"name": "puma", "convention": "chain", "joints": joints, "elements": elements})
    assert len(base_columns(robot)) == 36


def test_a_drive_carries_what_is_linked_to_it_and_nothing_else() -> None:
    arm = coupled()
    rng = np.random.default_rng(1)
    q = rng.uniform(-1.0, 1.0, (1, arm.n))
    for drive in (None, "linkage"):
        robot = robot_from_document(said(arm, drive))
        own = (rigid_regressor(robot, q, 0 * q, 0 * q) @ stated_numbers(robot))[0]
        expected = arm.reactions(q[0])[0]
        others = [0, 2, 3, 4, 5]
        np.testing.assert_allclose(own[others], expected[others], atol=1e-10)
        assert (abs(own[1] - expected[1]) > 1e-3) == (drive == "linkage")


def test_an_arm_without_stated_links_has_a_body_behind_every_joint() -> None:
    _, robot, rng = arm_robot("revolute", 4, 3)
    bare = replace(robot, links=())
    named = replace(robot, links=tuple(Link(k, 0.0, np.zeros(3)) for k in robot.chain.primary))
    q, qd, qdd = (rng.uniform(-1.0, 1.0, (5, 4)) for _ in range(3))
    np.testing.assert_array_equal(rigid_regressor(bare, q, qd, qdd), rigid_regressor(named, q, qd, qdd))
