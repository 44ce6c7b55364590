"""Poses and torques of one arm, fitted one after the other and both together: the same compliances with the same intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Robot
from kilter_core.effects.compliance import AxialCompliance
from kilter_core.effects.masses import LoadError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.observations import Observations
from kilter_core.parameters import CorrelatedPrior
from tests.core.identify.test_carried_masses import ASKED, believed, standing
from tests.core.truth import Arm, Body, Floats

SOFT = {2: 2e-6, 3: 3e-6, 4: 4e-6}  # rad/(N m) by joint, from 1: so stiff that loads are the same where it hangs
NOISE_M = 2e-6
NOISE_NM = 1.0
JOINTS = range(1, 7)
HELD = 12  # rows in which the arm is held still and its torques are read


def measure(arm: Arm, rng: np.random.Generator) -> Observations:
    q = np.array([0.0, -1.2, 1.4, -0.6, 0.9, 0.2]) + rng.uniform(-1.2, 1.2, (60, 6))
    bent = q - np.array([SOFT.get(j, 0.0) for j in JOINTS]) * arm.torques(q)
    return Observations(q, position=arm.poses(bent)[0] + rng.normal(0.0, NOISE_M, (60, 3)))


def as_believed(robot: Robot) -> Arm:
    """The arm with the bodies that its user describes."""
    bodies = tuple(Body(j, link.mass, np.asarray(link.com)) for j, link in enumerate(robot.links))
    return replace(standing(), bodies=bodies)


def torque_columns(arm: Arm, q: Floats) -> tuple[Floats, Floats]:
    """Torques (N, n) of the arm at rest, and what one unit of each load error adds: (N, n, 24)."""
    here, columns = arm.torques(q), []
    for k, body in enumerate(arm.bodies):
        for mass, moment in ((1.0, np.zeros(3)), *((0.0, axis) for axis in np.eye(3))):
            heavier = body.mass + mass
            one = Body(body.joint, heavier, (heavier * body.com + moment) / heavier)
            columns.append(replace(arm, bodies=(*arm.bodies[:k], one, *arm.bodies[k + 1 :])).torques(q) - here)
    return here, np.stack(columns, axis=2)


def fit_together(
    arm: Arm, poses: Observations, q: Floats, read: Floats, wide: Floats, c_wide: float
) -> tuple[Floats, Floats]:
    """Compliances and their standard deviations, of poses, torques and what was described."""
    held, by_held = torque_columns(arm, q)
    load, by_load = torque_columns(arm, poses.q)
    joints = [j - 1 for j in SOFT]
    assert poses.position is not None

    def left(x: Floats) -> Floats:
        bent = poses.q.copy()
        bent[:, joints] -= 1e-6 * x[:3] * (load + by_load @ x[3:])[:, joints]
        return np.concatenate(
            [
                ((arm.poses(bent)[0] - poses.position) / NOISE_M).ravel(),
                ((held + by_held @ x[3:] - read) / NOISE_NM).ravel(),
                x[3:] / wide,
                1e-6 * x[:3] / c_wide,
            ]
        )

    found = least_squares(left, np.concatenate([np.ones(3), np.zeros(24)]), x_scale="jac", xtol=1e-14, ftol=1e-14)
    return 1e-6 * found.x[:3], 1e-6 * np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))[:3]


def fit_in_turn(robot: Robot, poses: Observations, told: CorrelatedPrior) -> tuple[Floats, Floats]:
    """The same of poses alone, by what torques ``told``; rows count as independent."""
    geometry = tuple(robot.chain.elements[k].parameter().name for k in robot.chain.named_elements)
    options = IdentifyOptions(effects=(ASKED,), fix=geometry, base="fixed", tool="fixed", noise_mm=1e3 * NOISE_M)
    fit = identify(replace(robot, told_loads=told), poses, None, options).fit
    assert fit.names[3:] == told.names
    prior = np.zeros((len(fit.names), len(fit.names)))
    prior[3:, 3:] = np.linalg.inv(told.covariance)
    return fit.values[fit.problem.free][:3], np.sqrt(np.diag(np.linalg.inv(fit.J.T @ fit.J + prior)))[:3]


@pytest.mark.parametrize("seed", range(1, 5))
def test_torques_first_and_poses_then_are_the_fit_of_both(seed: int) -> None:
    rng = np.random.default_rng(900 + seed)
    robot = believed(robot_from_document(standing().document()), seed)
    arm, poses = as_believed(robot), measure(standing(), rng)
    q = rng.uniform(-1.5, 1.5, (HELD, 6))
    read = standing().torques(q) + rng.normal(0.0, NOISE_NM, (HELD, 6))
    own = LoadError().parameters(robot)
    wide = np.array([p.prior_sigma for p in own])
    held, by_held = torque_columns(arm, q)
    A, apart = by_held.reshape(-1, 24) / NOISE_NM, (read - held).ravel() / NOISE_NM
    spread = np.linalg.inv(A.T @ A + np.diag(wide**-2.0))
    told = CorrelatedPrior(tuple(p.name for p in own), spread @ A.T @ apart, spread)
    (c_wide,) = {p.prior_sigma for p in AxialCompliance().parameters(robot)}
    both, sigma = fit_together(arm, poses, q, read, wide, c_wide)
    value, in_turn = fit_in_turn(robot, poses, told)
    assert np.all(np.abs(value - both) < 0.02 * sigma)
    assert in_turn == pytest.approx(sigma, rel=0.005)
    value, in_turn = fit_in_turn(robot, poses, replace(told, covariance=np.diag(np.diag(spread))))
    assert np.any(in_turn > 2.0 * sigma)  # what hangs together counts
