"""All joints of arms without a closed form, against the forward kinematics of Pinocchio: none is missed unsaid."""

from __future__ import annotations

import numpy as np
import pinocchio
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.model.closed_inverse import read_six_axes
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
    axes, model, rng = read_six_axes(robot_from_document(document(rows))), peer(rows), np.random.default_rng(seed)
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
    # A root is in doubt within 0.001 rad of a singular posture, where one pose in a hundred may be.
    assert uncertain <= 3


def test_a_pose_out_of_reach_has_no_joints_and_that_is_certain() -> None:
    T = np.eye(4)
    T[0, 3] = 5.0
    assert reaching(read_six_axes(robot_from_document(document(CHAINS["offset wrist"]))), T) == ([], True)


def jacobian(model: pinocchio.Model, q: Floats) -> Floats:
    data, frame = model.createData(), model.getFrameId("flange")
    found: Floats = pinocchio.computeFrameJacobian(model, data, q, frame, pinocchio.ReferenceFrame.LOCAL)
    return found


def singular_posture(model: pinocchio.Model, rng: np.random.Generator) -> Floats:
    """A posture where two solutions become one, between two where the determinant has other signs."""

    def determinant(q: Floats) -> float:
        return float(np.linalg.det(jacobian(model, q)))

    low, high = rng.uniform(-np.pi, np.pi, (2, 6))
    while determinant(low) * determinant(high) > 0:
        high = rng.uniform(-np.pi, np.pi, 6)
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if determinant(middle) * determinant(low) > 0 else (low, middle)
    return np.asarray(low)


def test_at_a_singularity_the_joints_are_not_certain() -> None:
    rows = CHAINS["nothing meets"]
    axes, model = read_six_axes(robot_from_document(document(rows))), peer(rows)
    q = singular_posture(model, np.random.default_rng(0))
    assert not all_angles(axes, flange_by_peer(model, q)).certain


def test_two_solutions_that_are_nearly_one_are_both_found_or_the_pose_is_not_certain() -> None:
    """Their roots are nearly double: an imaginary part that is rounding alone must not make them none."""
    rows, rng = CHAINS["nothing meets"], np.random.default_rng(9)
    axes, model = read_six_axes(robot_from_document(document(rows))), peer(rows)
    certain_far = 0
    for _ in range(3):
        q = singular_posture(model, rng)
        free = np.linalg.svd(jacobian(model, q))[2][-1]
        for apart_rad in (1e-2, 1e-3, 1e-4, 1e-6):
            near = q + apart_rad * free
            found, certain = reaching(axes, flange_by_peer(model, near))
            certain_far += certain and apart_rad == 1e-2
            if certain:
                assert min(apart(one.q, near) for one in found) < 1e-6
                assert min(apart(one.q, q - apart_rad * free) for one in found) < 30 * apart_rad**2
    assert certain_far >= 2
