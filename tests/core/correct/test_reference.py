"""Corrected joints put an independent arm, with the errors the calibration knows, where it is wanted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.effects import make_effect
from kilter_core.errors import OptionError
from kilter_core.model import Calibration, RobotModel
from tests.core.campaigns import joints, table_errors
from tests.core.correct.reference import CorrectOptions, Status, correct
from tests.core.truth import Arm, Body, Step, small_pose, some_arm, some_pose, ur10, with_bodies

Floats = NDArray[np.float64]
FREE = CorrectOptions(max_joint_rad=0.2, max_shift_m=0.1)


def knowing(nominal: Arm, errors: dict[str, float]) -> Calibration:
    """A calibration of the nominal arm that knows its errors exactly."""
    model = RobotModel(robot_from_document(nominal.document()))
    return Calibration(model, model.values0() + [errors.get(name, 0.0) for name in model.names])


def distances(found: Floats, wanted: Floats) -> Floats:
    return np.asarray(np.linalg.norm(found - wanted, axis=1))


def angles(found: Floats, wanted: Floats) -> Floats:
    return np.array([np.linalg.norm(pin.log3(a.T @ b)) for a, b in zip(found, wanted, strict=True)])


def reachable(arm: Arm, rng: np.random.Generator, rows: int, count: int) -> Floats:
    """Joints away from the arm's singular poses, where any correction is large."""
    q = joints(arm, 20 * count, rng)
    smallest = np.linalg.svd(arm.joint_jacobians(q)[:, :rows], compute_uv=False)[:, -1]
    return np.asarray(q[smallest > 0.05][:count])


@pytest.mark.parametrize("n", [5, 6, 7])
@pytest.mark.parametrize("seed", range(3))
def test_the_true_arm_lands_where_the_nominal_arm_would(n: int, seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    nominal = some_arm(rng, n)
    errors = table_errors(nominal, rng, 2e-4, 4e-4)
    true = nominal.moved(errors)
    q = reachable(nominal, rng, 3 if n < 6 else 6, 60)
    assert len(q) > 10
    result = correct(knowing(nominal, errors), q, options=replace(FREE, task="position" if n < 6 else "pose"))
    assert (result.status == Status.OK).all()
    assert result.converged.all()
    assert result.held == (("x", "y", "z") if n < 6 else ("x", "y", "z", "rx", "ry", "rz"))
    wanted, before, after = (arm.poses(joints_) for arm, joints_ in ((nominal, q), (true, q), (true, result.q)))
    assert np.max(distances(after[0], wanted[0])) <= 1e-6
    assert np.mean(distances(before[0], wanted[0])) > 1e-4
    if n >= 6:
        assert np.max(angles(after[1], wanted[1])) <= 1e-6
    # The error is told in the axes of the wanted base.
    told = result.error_removed @ nominal.base.rotation.T
    np.testing.assert_allclose(told, before[0] - wanted[0], atol=1e-12)


def test_a_position_task_on_six_joints_holds_the_point_only() -> None:
    rng = np.random.default_rng(1)
    nominal = ur10(tool=small_pose(rng, 0.1, 0.3))
    errors = table_errors(nominal, rng)
    q = reachable(nominal, rng, 3, 40)
    result = correct(knowing(nominal, errors), q, options=replace(FREE, task="position"))
    assert result.held == ("x", "y", "z")
    fine = result.status == Status.OK
    assert fine.mean() > 0.9
    assert np.max(distances(nominal.moved(errors).poses(result.q[fine])[0], nominal.poses(q[fine])[0])) <= 1e-6
    with pytest.raises(OptionError, match="task"):
        correct(knowing(nominal, errors), q, options=CorrectOptions(task="line"))


def test_compliance_under_load_is_corrected_with_the_loads_of_newton_and_euler() -> None:
    rng = np.random.default_rng(101)
    nominal = replace(with_bodies(some_arm(rng, 6), rng), gravity=(0.0, 0.0, -9.80665), base=pin.SE3.Identity())
    errors = table_errors(nominal, rng, 2e-4, 4e-4)
    compliance = rng.uniform(0.5e-5, 2e-5, 6)
    geometric = knowing(nominal, errors)
    soft = geometric.with_effects((make_effect("axial_compliance"),))
    values = soft.values.copy()
    values[[soft.names.index(f"compliance_{j}") for j in range(1, 7)]] = compliance
    q = reachable(nominal, rng, 6, 40)
    assert len(q) > 10
    kg, place = np.full(len(q), 3.0), np.tile([0.0, 0.0, 0.05], (len(q), 1))
    result = correct(replace(soft, values=values), q, payload_kg=kg, payload_com=place, options=FREE)
    assert (result.status == Status.OK).all()
    twist = [-compliance * nominal.reactions(row, payload=(3.0, place[0]))[0] for row in result.q]
    landed, _ = nominal.moved(errors).poses(result.q + twist)
    assert np.max(distances(landed, nominal.poses(q)[0])) <= 1e-6
    rigid = correct(geometric, q, options=FREE)
    assert np.mean(distances(nominal.moved(errors).poses(rigid.q + twist)[0], nominal.poses(q)[0])) > 1e-5


def test_wanted_frames_are_those_of_the_measurements_when_the_robot_s_own_are_unknown() -> None:
    rng = np.random.default_rng(3)
    nominal = ur10(tool=small_pose(rng, 0.1, 0.3))
    errors = table_errors(nominal, rng)
    base, off = some_pose(rng, 3.0), small_pose(rng, 5e-4, 5e-4)
    calibration = knowing(nominal, errors)
    seen = replace(
        calibration, model=replace(calibration.model, T_base=(base * off).homogeneous), wanted_base=base.homogeneous
    )
    q = reachable(nominal, rng, 6, 30)
    result = correct(seen, q, options=FREE)
    true = replace(nominal.moved(errors), base=base * off)
    wanted = replace(nominal, base=base)
    assert np.max(distances(true.poses(result.q)[0], wanted.poses(q)[0])) <= 1e-6


def test_refused_rows_hold_no_numbers_to_misuse() -> None:
    nominal = ur10(tool=pin.SE3(np.eye(3), np.array([0.05, 0.0, 0.1])), limits=(-2.0, 2.0))
    q = np.tile([0.3, -1.0, 1.2, -0.5, 0.8, 0.1], (4, 1))
    q[1, 2] = np.nan
    q[2, 0] = 2.0
    result = correct(knowing(nominal, {"theta_offset_1": -1e-3}), q)
    assert result.status.tolist() == [Status.OK, Status.NOT_FINITE, Status.JOINT_LIMIT, Status.OK]
    assert np.isnan(result.q[1:3]).all()
    assert np.isfinite(result.q[[0, 3]]).all()


def test_a_correction_larger_than_agreed_is_refused() -> None:
    nominal = ur10(tool=pin.SE3(np.eye(3), np.array([0.05, 0.0, 0.1])))
    q = np.tile([0.3, -1.0, 1.2, -0.5, 0.8, 0.1], (1, 1))
    calibration = knowing(nominal, {"theta_offset_3": 0.02})
    assert correct(calibration, q).status.tolist() == [Status.CORRECTION_TOO_LARGE]
    generous = CorrectOptions(max_joint_rad=0.1, max_shift_m=0.1)
    assert correct(calibration, q, options=generous).status.tolist() == [Status.OK]
    short = CorrectOptions(max_joint_rad=0.1, max_shift_m=1e-3)
    assert correct(calibration, q, options=short).status.tolist() == [Status.CORRECTION_TOO_LARGE]


def test_near_a_singular_pose_the_correction_is_bounded_or_refused() -> None:
    rng = np.random.default_rng(4)
    nominal = ur10(tool=small_pose(rng, 0.05, 0.1))
    errors = table_errors(nominal, rng)
    angle = np.array([0.0, 1e-9, 1e-6, 1e-4, 1e-3, 1e-2])
    q = np.tile([0.3, -1.0, 1.2, -0.5, 0.0, 0.1], (len(angle), 1))
    q[:, 4] = angle  # the wrist of a UR is singular at zero
    limits = CorrectOptions()
    result = correct(knowing(nominal, errors), q, options=limits)
    fine = result.status == Status.OK
    assert (np.abs(result.q[fine] - q[fine]) <= limits.max_joint_rad).all()
    assert np.isfinite(result.residual).all()


def test_an_arm_that_slides_is_corrected_in_metres() -> None:
    steps = (
        Step("tz", 0.0, 0, 1.0, "z"), Step("rz", 0.0, 1, 1.0, "one"), Step("tx", 0.4, name="a_1"),
        Step("rz", 0.0, 2, 1.0, "two"), Step("tx", 0.3, name="a_2"),
    )  # fmt: skip
    nominal = Arm(steps, 3, bodies=(Body(0, 1.0, np.zeros(3)),))
    q = np.array([[0.1, 0.2, 0.9], [0.2, -0.5, 1.3]])
    errors = {"z": 1e-3, "two": 1e-3, "a_1": -2e-4}
    result = correct(knowing(nominal, errors), q)
    assert (result.status == Status.OK).all()
    np.testing.assert_allclose(result.q[:, 0], q[:, 0] - 1e-3, atol=1e-9)
    assert np.max(distances(nominal.moved(errors).poses(result.q)[0], nominal.poses(q)[0])) <= 1e-6


def test_no_rows_give_no_rows() -> None:
    result = correct(knowing(ur10(), {}), np.zeros((0, 6)))
    assert result.q.shape == (0, 6)
