"""Linkages: what a motor carries of the axes that follow its joint, by virtual work. Energies of Pinocchio are the truth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.conversions import robot_document
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.documents.parts import resolved_document, robot_from_resolved
from kilter_core.arm.load_slopes import LoadSlopes, with_masses
from kilter_core.arm.load_wrenches import axial_loads, joint_loads, row_load_wrenches
from kilter_core.errors import RobotError
from kilter_core.observations import Observations
from tests.core.palletiser import palletiser, said
from tests.core.truth import Body

Floats = np.ndarray


def by_energy(arm: Any, q: Floats, payload: tuple[float, Floats] | None = None) -> Floats:
    """What gravity does to each motor (n,): minus the slope of the potential energy over the motors' own coordinates."""
    model, _ = arm.pinocchio(payload)
    data, h, out = model.createData(), 1e-5, np.zeros(arm.n)
    for j in range(arm.n):
        step = np.zeros(arm.n)
        step[j] = h
        ends = [pin.computePotentialEnergy(model, data, arm.motors(q + way * step)) for way in (1.0, -1.0)]
        out[j] = -(ends[0] - ends[1]) / (2.0 * h)
    return out


@pytest.mark.parametrize("ratio", [-1.0, -0.6])
def test_the_gear_of_a_linkage_carries_all_axes_by_virtual_work(ratio: float) -> None:
    arm = palletiser(ratio)
    robot = robot_from_document(said(arm, "linkage"))
    rng = np.random.default_rng(0)
    q = rng.uniform(-1.2, 1.2, (12, arm.n))
    place = np.array([0.05, -0.02, 0.1])
    kg, com = np.full(len(q), 7.0), np.tile(place, (len(q), 1))
    ours = axial_loads(robot, joint_loads(robot, q, payload_kg=kg, payload_com=com))
    truth = np.array([by_energy(arm, row, (7.0, place)) for row in q])
    np.testing.assert_allclose(ours, truth, atol=2e-6 * np.abs(truth).max(), rtol=0)


def test_masses_on_the_links_of_a_linkage_are_carried_by_virtual_work_too() -> None:
    arm = palletiser(-1.0)
    robot = robot_from_document(said(arm, "linkage"))
    q, rng = np.random.default_rng(3).uniform(-1.2, 1.2, (8, arm.n)), np.random.default_rng(4)
    mass = np.concatenate([rng.uniform(1.0, 5.0, (1, arm.n, 1)), rng.uniform(-0.2, 0.2, (1, arm.n, 3))], axis=2)
    ours = axial_loads(robot, joint_loads(robot, q, link_mass=np.tile(mass, (8, 1, 1))))
    more = tuple(Body(j, kg, np.array(place)) for j, (kg, *place) in enumerate(mass[0]))
    truth = np.array([by_energy(replace(arm, bodies=(*arm.bodies, *more)), row) for row in q])
    np.testing.assert_allclose(ours, truth, atol=2e-6 * np.abs(truth).max(), rtol=0)


def test_on_a_parallelogram_motor_two_carries_tau2_less_tau3() -> None:
    arm = palletiser(-1.0)
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (8, arm.n))
    apart = {}
    for drive in ("linkage", "controller", "series", None):
        robot = robot_from_document(said(arm, drive))
        apart[drive] = axial_loads(robot, joint_loads(robot, q))
    np.testing.assert_allclose(apart["linkage"][:, 1], apart[None][:, 1] - apart[None][:, 2], atol=1e-9, rtol=0)
    assert np.abs(apart["linkage"][:, 1] - apart[None][:, 1]).max() > 10.0
    for drive in ("controller", "series"):
        np.testing.assert_array_equal(apart[drive], apart[None])
    np.testing.assert_array_equal(apart["linkage"][:, [0, 2, 3]], apart[None][:, [0, 2, 3]])


def test_in_motion_the_power_of_the_motors_is_that_of_the_bodies() -> None:
    """Virtual work with inertia: sum of motor load times speed is minus what moves the bodies, axis by axis of Pinocchio."""
    arm = palletiser(-1.0)
    robot = robot_from_document(said(arm, "linkage"))
    rng = np.random.default_rng(2)
    q, qd, qdd = (rng.normal(size=(6, arm.n)) for _ in range(3))
    ours = axial_loads(robot, joint_loads(robot, q, qd=qd, qdd=qdd))
    model, _ = arm.pinocchio()
    for k in range(len(q)):
        tau = pin.rnea(model, model.createData(), arm.motors(q[k]), arm.rates(qd[k]), arm.rates(qdd[k]))
        power = sum(tau[m] * step.ratio * qd[k][step.joint] for m, step in enumerate(arm.moving))
        assert float(ours[k] @ qd[k]) == pytest.approx(-power, rel=1e-9)


@pytest.mark.parametrize("moves", [False, True])
def test_slopes_by_the_masses_follow_linkages(moves: bool) -> None:
    arm = palletiser(-1.0)
    robot = robot_from_document(said(arm, "linkage"))
    rng = np.random.default_rng(3)
    motion = {"qd": rng.normal(size=(5, arm.n)), "qdd": rng.normal(size=(5, arm.n))} if moves else {}
    rows = Observations(rng.normal(size=(5, arm.n)), **motion)
    slopes = LoadSlopes(robot, rows)
    errors = 1e-3 * rng.normal(size=len(slopes))
    once, anew = row_load_wrenches(robot, rows), row_load_wrenches(with_masses(robot, errors), rows)
    moved = axial_loads(robot, anew) - axial_loads(robot, once)
    np.testing.assert_allclose(
        np.tensordot(errors, slopes.component_slopes("axial", 0), axes=1), moved, atol=1e-9, rtol=0
    )
    np.testing.assert_allclose(LoadSlopes(robot, rows).changes("axial", (0,), errors)[0], moved, atol=1e-9, rtol=0)


def test_the_drive_is_kept_by_documents_and_conversions() -> None:
    robot = robot_from_document(said(palletiser(-1.0), "linkage"))
    q = np.random.default_rng(4).uniform(-1.0, 1.0, (4, robot.n_joints))
    expected = axial_loads(robot, joint_loads(robot, q))
    for again in (
        robot_from_resolved("again", resolved_document(robot)),
        *(robot_from_document(robot_document(robot, convention)) for convention in ("chain", "poe")),
    ):
        np.testing.assert_allclose(axial_loads(again, joint_loads(again, q)), expected, atol=1e-8, rtol=0)
    unsaid = resolved_document(robot_from_document(said(palletiser(-1.0), None)))
    assert not any("drive" in element for element in unsaid["elements"])  # robots stored earlier keep their hash


@pytest.mark.parametrize("drive", ["rods", "linkage"])
def test_a_drive_that_is_none_is_refused_with_its_place(drive: str) -> None:
    document = said(palletiser(-1.0), "linkage")
    own = next(k for k, e in enumerate(document["elements"]) if e.get("joint") == "j2")
    document["elements"][own]["drive"] = drive
    with pytest.raises(RobotError, match="drive"):
        robot_from_document(document)
    document = said(palletiser(-1.0), "linkage")
    document["joints"] = [{**joint, "drive": "linkage"} for joint in document["joints"]]
    with pytest.raises(RobotError, match="give it to that axis"):
        robot_from_document(document)


def test_replacing_the_bodies_does_not_move_the_linkage() -> None:
    arm = palletiser(-1.0)
    heavier = replace(arm, bodies=tuple(replace(b, mass=2.0 * b.mass) for b in arm.bodies))
    q = np.zeros((1, arm.n))
    one, two = (
        axial_loads(r, joint_loads(r, q)) for r in (robot_from_document(said(a, "linkage")) for a in (arm, heavier))
    )
    np.testing.assert_allclose(two, 2.0 * one, rtol=1e-12)
