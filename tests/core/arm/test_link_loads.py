"""Masses that something else moves, forces and moments on links: Pinocchio says what they put on the joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.load_wrenches import axial_loads, joint_loads
from kilter_core.correct.program import CorrectionOptions
from kilter_core.correct.walker import correct_trajectory
from kilter_core.gap import GapOptions, find_gap
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.truth import JOINT_FRAME, Arm, Body, Step, some_arm, with_bodies

Floats = NDArray[np.float64]


def arm_of(seed: int) -> tuple[Arm, np.random.Generator]:
    rng = np.random.default_rng(seed)
    made = replace(with_bodies(some_arm(rng, 5, prismatic=seed % 2 == 0), rng), base=pin.SE3.Identity())
    return made, rng


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_masses_on_links_load_the_joints_as_bodies_would(seed: int) -> None:
    arm, rng = arm_of(seed)
    robot, q = robot_from_document(arm.document()), rng.uniform(-2.0, 2.0, (6, 5))
    mass = np.concatenate([rng.uniform(0.0, 4.0, (6, 5, 1)), rng.uniform(-0.3, 0.3, (6, 5, 3))], axis=2)
    mass[:, 1] = 0.0
    found = joint_loads(robot, q, link_mass=mass)
    for k in range(6):
        more = tuple(Body(j, kg, np.array(place)) for j, (kg, *place) in enumerate(mass[k]) if kg > 0.0)
        torques, wrenches, root = replace(arm, bodies=arm.bodies + more).reactions(q[k])
        np.testing.assert_allclose(found.joints[k], -wrenches, atol=1e-9)
        np.testing.assert_allclose(found.base[k], -root, atol=1e-9)
        np.testing.assert_allclose(axial_loads(robot, found)[k], -torques, atol=1e-9)


@pytest.mark.parametrize("seed", [1, 2])
def test_forces_and_moments_on_links_are_pinocchios_external_forces(seed: int) -> None:
    arm, rng = arm_of(seed)
    robot, q = robot_from_document(arm.document()), rng.uniform(-2.0, 2.0, (5, 5))
    wrench = rng.normal(0.0, 20.0, (5, 5, 6))
    found = joint_loads(robot, q, link_wrench=wrench)
    model, _ = arm.pinocchio()
    data = model.createData()
    for k in range(5):
        forces = pin.StdVec_Force()
        for _ in range(model.njoints):
            forces.append(pin.Force.Zero())
        for j in range(5):
            forces[1 + arm.first_of(j)] = pin.Force(wrench[k, j])
        pin.rnea(model, data, arm.motors(q[k]), np.zeros(model.nv), np.zeros(model.nv), forces)
        for j in range(5):
            step, f = arm.moving[arm.first_of(j)], data.f[1 + arm.first_of(j)]
            turn = JOINT_FRAME[step.axis[1]] @ (np.diag([1.0, -1.0, -1.0]) if step.ratio < 0 else np.eye(3))
            held = np.concatenate([turn.T @ f.linear, turn.T @ f.angular])
            np.testing.assert_allclose(found.joints[k, j], -held, atol=1e-9)


def test_the_ends_of_links_carry_what_is_beyond() -> None:
    """The same masses as links of the robot, which another code sums up."""
    arm, rng = arm_of(4)
    robot, q = robot_from_document(arm.document()), rng.uniform(-2.0, 2.0, (6, 5))
    mass = np.array(
        [[2.0, 0.1, 0.0, 0.2], [0.0, 0.0, 0.0, 0.0], [1.0, 0.0, -0.2, 0.1], [3.0, 0.2, 0.1, 0.0], [0.5, 0, 0, 0.1]]
    )
    heavier = [Body(j, kg, np.array(place)) for j, (kg, *place) in enumerate(mass)]
    alone = robot_from_document(replace(arm, bodies=tuple(heavier)).document())
    np.testing.assert_allclose(
        joint_loads(robot, q, link_mass=np.tile(mass, (6, 1, 1))).ends,
        joint_loads(robot, q).ends + joint_loads(alone, q).ends, atol=1e-10,
    )  # fmt: skip


TORSO_RAD = 4e-5  # per N m, of the joint that bends forwards
TORSO = Arm(
    (
        Step("rz", 0.0, 0, name="turn"), Step("tz", 0.4, name="a"), Step("ry", 0.0, 1, name="bend"), Step("tz", 0.5, name="b"),
        Step("ty", 0.2, name="side"), Step("ry", 0.0, 2, name="shoulder"), Step("tx", 0.3, name="c"),
        Step("rz", 0.0, 3, name="elbow"), Step("tx", 0.3, name="d"),
    ), 4, tool=pin.SE3(np.eye(3), np.array([0.05, 0.0, 0.05])),
    bodies=(
        Body(1, 12.0, np.array([0.02, 0.0, 0.25])), Body(2, 2.5, np.array([0.15, 0.0, 0.0])),
        Body(3, 1.5, np.array([0.15, 0.0, 0.0])),
    ),
)  # fmt: skip
OTHER_KG = (3.0, 2.0)  # links of the arm on the other side


def other_arm(q: Floats) -> tuple[Floats, Floats]:
    """Mass (N,) and its centre (N, 3) in the frame of the torso, of two links about y from a shoulder on the other side."""
    first = np.column_stack([0.15 * np.cos(q[:, 0]), np.full(len(q), -0.2), 0.5 - 0.15 * np.sin(q[:, 0])])
    a, b = q[:, 0], q[:, 0] + q[:, 1]
    far = np.column_stack(
        [0.3 * np.cos(a) + 0.15 * np.cos(b), np.full(len(q), -0.2), 0.5 - 0.3 * np.sin(a) - 0.15 * np.sin(b)]
    )
    total = sum(OTHER_KG)
    return np.full(len(q), total), (OTHER_KG[0] * first + OTHER_KG[1] * far) / total


def where(q: Floats, kg: Floats, place: Floats) -> Floats:
    """Tool points of the torso whose second joint yields to all that hangs on it."""
    torque = np.array(
        [
            replace(TORSO, bodies=(*TORSO.bodies, Body(1, m, at))).reactions(row)[0][1]
            for row, m, at in zip(q, kg, place, strict=True)
        ]
    )
    bent = q.copy()
    bent[:, 1] -= TORSO_RAD * torque
    return TORSO.poses(bent)[0]


def torso_rows(count: int, seed: int) -> Observations:
    rng = np.random.default_rng(seed)
    q = rng.uniform([-2.0, -0.4, -2.0, -2.0], [2.0, 1.0, 2.0, 2.0], (count, 4))
    kg, place = other_arm(rng.uniform(-2.5, 2.5, (count, 2)))
    mass = np.zeros((count, 4, 4))
    mass[:, 1] = np.column_stack([kg, place])
    return Observations(q, position=where(q, kg, place) + rng.normal(0.0, 2e-5, (count, 3)), link_mass=mass)


def test_the_other_arm_of_a_torso_is_a_mass_that_other_columns_move() -> None:
    robot, rows, rest = robot_from_document(TORSO.document()), torso_rows(80, 1), torso_rows(40, 2)
    left = {}
    for name, given, held in (
        ("unknown", replace(rows, link_mass=None), replace(rest, link_mass=None)), ("known", rows, rest),
    ):  # fmt: skip
        options = IdentifyOptions(effects=("axial_compliance",), noise_mm=0.02)
        found = identify(robot, given, options=options).calibration
        error = found.predict(held).position - rest.position
        left[name] = float(np.sqrt(np.mean(np.sum(error**2, axis=1))))
    assert left["unknown"] > 2e-4
    assert left["known"] < 5e-5
    assert found.values[found.names.index("compliance_2")] == pytest.approx(TORSO_RAD, rel=0.02)
    options = GapOptions(
        effects=("axial_compliance", "radial_compliance", "eccentricity"), noise_mm=0.02, resamples=10, permutations=5
    )
    named = find_gap(robot, rows, options).to_document()["effects"]
    assert [(e["id"], e["joints"]) for e in named] == [("axial_compliance", [2])]


def test_a_row_that_states_the_mass_is_corrected_for_it() -> None:
    robot, rows = robot_from_document(TORSO.document()), torso_rows(80, 1)
    found = identify(robot, rows, options=IdentifyOptions(effects=("axial_compliance",), noise_mm=0.02)).calibration
    path = torso_rows(30, 3)
    assert path.link_mass is not None
    done = correct_trajectory(found, replace(path, position=None), CorrectionOptions(largest_rad=0.1, farthest_m=0.05))
    good = np.linalg.norm(done.left, axis=1) < 1e-6
    assert good.sum() > 20
    reached = where(done.q, path.link_mass[:, 1, 0], path.link_mass[:, 1, 1:])
    wanted = found.nominal_in_wanted_frames().predict(Observations(path.q)).position
    assert np.linalg.norm(reached - wanted, axis=1)[good].max() < 1e-4
    plain = correct_trajectory(found, Observations(path.q), CorrectionOptions(largest_rad=0.1, farthest_m=0.05))
    elsewhere = where(plain.q, path.link_mass[:, 1, 0], path.link_mass[:, 1, 1:])
    assert np.median(np.linalg.norm(elsewhere - wanted, axis=1)) > 2e-4


def test_without_an_effect_that_reads_loads_masses_change_nothing() -> None:
    robot, rows = robot_from_document(TORSO.document()), torso_rows(10, 5)
    nominal = Calibration.nominal(robot)
    np.testing.assert_array_equal(
        nominal.predict(rows).position, nominal.predict(replace(rows, link_mass=None)).position
    )
    assert (correct_trajectory(nominal, rows).status == 0).all()
