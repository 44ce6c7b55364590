"""All joints of arms without a closed form, against the forward kinematics of Pinocchio: none is missed unsaid."""

from __future__ import annotations

import numpy as np
import pinocchio
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.model.closed_inverse import axes_of
from kilter_core.model.general_inverse import all_angles, reaching

Floats = NDArray[np.float64]
Rows = list[tuple[float, float, float, float]]  # theta deg, d mm, a mm, alpha deg
CHAINS: dict[str, Rows] = {
    "nothing meets": [
        (10, 300, 40, -80), (-70, 20, 420, 15), (5, -30, 60, -95), (20, 400, 25, 70), (-15, 35, 30, -75), (40, 120, 15, 5),
    ],
    "skew wrist": [
        (0, 400, 25, -90), (-90, 0, 560, 0), (0, 0, 35, -90), (0, 515, 0, 60), (0, 80, 0, -60), (0, 90, 0, 0),
    ],
    "offset wrist": [
        (0, 245, 0, -90), (-90, 0, 540, 0), (0, 0, 0, -90), (0, 540, 0, 90), (0, 150, 0, -90), (0, 160, 0, 0),
    ],
}  # fmt: skip
SAME_RAD = 1e-9


def document(rows: Rows) -> dict[str, object]:
    return {
        "name": "arm", "convention": "dh",
        "rows": [
            {"type": "revolute", "theta_offset_deg": theta, "d_mm": d, "a_mm": a, "alpha_deg": alpha}
            for theta, d, a, alpha in rows
        ],
    }  # fmt: skip


def peer(rows: Rows) -> pinocchio.Model:
    """The arm by Pinocchio: after each joint, which turns about z, a placement."""
    model, parent, placed = pinocchio.Model(), 0, pinocchio.SE3.Identity()
    for k, (theta, d, a, alpha) in enumerate(rows):
        turn = pinocchio.SE3(pinocchio.rpy.rpyToMatrix(0.0, 0.0, np.radians(theta)), np.zeros(3))
        parent = model.addJoint(parent, pinocchio.JointModelRZ(), placed * turn, f"j{k}")
        placed = pinocchio.SE3(pinocchio.rpy.rpyToMatrix(np.radians(alpha), 0.0, 0.0), np.array([a, 0.0, d]) / 1000.0)
    model.addFrame(pinocchio.Frame("flange", parent, 0, placed, pinocchio.FrameType.OP_FRAME))
    return model


def flange_by_peer(model: pinocchio.Model, q: Floats) -> Floats:
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, q)
    return np.asarray(data.oMf[model.getFrameId("flange")].homogeneous)


def apart(one: Floats, other: Floats) -> float:
    return float(np.abs(np.remainder(one - other + np.pi, 2 * np.pi) - np.pi).max())


def counted(name: str, seed: int, poses: int) -> tuple[int, int]:
    """How many poses were not certain, and how many joints were missed without a word."""
    rows = CHAINS[name]
    axes, model, rng = axes_of(robot_from_document(document(rows))), peer(rows), np.random.default_rng(seed)
    uncertain = missed = 0
    for _ in range(poses):
        q = rng.uniform(-np.pi, np.pi, 6)
        T = flange_by_peer(model, q)
        found, certain = reaching(axes, T)
        assert not any(one.named for one in found)
        for one in found:
            assert np.abs(flange_by_peer(model, one.q) - T).max() < 1e-9
        uncertain += not certain
        missed += certain and min((apart(one.q, q) for one in found), default=9.0) > SAME_RAD
    return uncertain, missed


@pytest.mark.parametrize("name", CHAINS)
def test_the_joints_that_made_a_pose_are_among_all_that_reach_it(name: str) -> None:
    uncertain, missed = counted(name, 3, 20)
    assert missed == 0
    assert uncertain <= 1


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", CHAINS)
def test_of_a_thousand_poses_none_is_missed_unsaid(name: str) -> None:
    uncertain, missed = counted(name, 4, 334)
    assert missed == 0
    assert uncertain < 34  # a tenth, of a wrist whose axes meet in pairs


def test_a_pose_out_of_reach_has_no_joints_and_that_is_certain() -> None:
    T = np.eye(4)
    T[0, 3] = 5.0
    assert reaching(axes_of(robot_from_document(document(CHAINS["offset wrist"]))), T) == ([], True)


def test_at_a_singularity_the_joints_are_not_certain() -> None:
    """An arm stretched out: two solutions become one."""
    rows = CHAINS["nothing meets"]
    axes, model = axes_of(robot_from_document(document(rows))), peer(rows)
    rng = np.random.default_rng(0)

    def determinant(q: Floats) -> float:
        jacobian = pinocchio.computeFrameJacobian(
            model, model.createData(), q, model.getFrameId("flange"), pinocchio.ReferenceFrame.LOCAL
        )
        return float(np.linalg.det(jacobian))

    low, high = rng.uniform(-np.pi, np.pi, (2, 6))
    while determinant(low) * determinant(high) > 0:
        high = rng.uniform(-np.pi, np.pi, 6)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if determinant(middle) * determinant(low) > 0 else (low, middle)
    assert not all_angles(axes, flange_by_peer(model, low)).certain
