"""What a position loop that feeds its encoder's noise into the torque does to a fit: MuJoCo drives, and logs both sides.

The same run is fitted twice: with the joints as the encoder read them, and as they were. The difference is what noise in
speeds, accelerations and the torque that answers to it puts a value off.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.motion.fit import covariance, fit_terms, joint_weights
from kilter_core.motion.layout import Layout
from kilter_core.motion.normal import form_equations
from kilter_core.motion.record import Log
from kilter_core.observations import Observations
from tests.core.motion.moving_arm import Logger, ur_like
from tests.core.truth import Arm, Floats

STEP_S, EVERY, SECONDS, MOTIONS = 1e-3, 10, 20.0, 3
LOOP_RAD_S, SPEED_RAD_S = 2.0 * np.pi * 5.0, 2.0 * np.pi * 30.0  # of the position loop, of its filter of speeds
USUAL = np.array([20.0, 40.0, 15.0, 3.0, 3.0, 1.5])  # N m


def solid_arm() -> Arm:
    arm = ur_like(np.random.default_rng(7))
    sums = [np.diag(np.trace(b.inertia) - np.diag(b.inertia)) for b in arm.bodies]
    return replace(arm, bodies=tuple(replace(b, inertia=i) for b, i in zip(arm.bodies, sums, strict=True)))


def mujoco_model(arm: Arm) -> mujoco.MjModel:
    """The arm with friction of its joints."""
    spec = mujoco.MjSpec()
    spec.option.gravity, spec.option.timestep = (0.0, 0.0, -9.80665), STEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    parent, at = spec.worldbody, pin.SE3.Identity()
    for step in arm.steps:
        if step.joint is None:
            at = at * step.motion()
            continue
        spun = pin.Quaternion(at.rotation)
        parent = parent.add_body(pos=at.translation, quat=[spun.w, spun.x, spun.y, spun.z])
        (body,) = (one for one in arm.bodies if one.joint == step.joint)
        parent.mass, parent.ipos, parent.explicitinertial = body.mass, body.com, True
        parent.fullinertia = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        parent.add_joint(
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=np.eye(3)["xyz".index(step.axis[1])],
            damping=0.1 * USUAL[step.joint],
            frictionloss=0.15 * USUAL[step.joint],
        )
        at = pin.SE3.Identity()
    return spec.compile()


def drive(
    arm: Arm, model: mujoco.MjModel, seed: int, noise: float, count: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Times, joints as read and as they were, and torques of the loop, a hundred rows a second."""
    planner, rng, rows = Logger(arm, seed=seed), np.random.default_rng(1000 + seed), []
    data = mujoco.MjData(model)
    for motion in range(MOTIONS):
        t = np.arange(0.0, SECONDS + 1.0, STEP_S)
        q, qd, _ = planner._path(t)
        data.qpos[:], data.qvel[:] = q[0], 0.0
        mujoco.mj_forward(model, data)
        full = np.empty((model.nv, model.nv))
        for k, unit in enumerate(np.eye(model.nv)):
            mujoco.mj_mulM(model, data, full[k], unit)
        inertia = np.diag(full)
        last, speed, held = q[0].copy(), np.zeros(6), data.qfrc_bias.copy()
        for i in range(len(t)):
            read = data.qpos + noise * rng.normal(size=6)
            read = count * np.round(read / count) if count else read
            speed += (1.0 - np.exp(-SPEED_RAD_S * STEP_S)) * ((read - last) / STEP_S - speed)
            last, off = read, q[i] - read
            held = held + inertia * LOOP_RAD_S**3 / 4.0 * off * STEP_S
            torque = inertia * (LOOP_RAD_S**2 * off + 1.6 * LOOP_RAD_S * (qd[i] - speed)) + held
            if t[i] >= 1.0 and i % EVERY == 0:
                rows.append(np.concatenate([[t[i] + 100.0 * motion], read, data.qpos, torque]))
            data.qfrc_applied[:] = torque
            mujoco.mj_step(model, data)
    table = np.array(rows)
    return table[:, 0], table[:, 1:7], table[:, 7:13], table[:, 13:]


def fit(arm: Arm, t: Floats, q: Floats, tau: Floats) -> tuple[Floats, Floats]:
    """Values of bodies and friction, and their standard errors."""
    robot = robot_from_document(arm.document())
    log = Log.from_observations(Observations(q=q, t=t, tau=tau))
    equations = form_equations(Layout.of_log(robot, log), log)
    every = np.ones(len(equations.motion), dtype=bool)
    found = fit_terms(equations, equations.terms, every, joint_weights(equations, equations.terms, every))
    return found.theta, np.sqrt(np.diag(covariance(equations, found, every)))


def bias_in_standard_errors(noise: float, count: float, draws: int) -> Floats:
    arm = solid_arm()
    model, apart, sigmas = mujoco_model(arm), [], []
    for seed in range(draws):
        t, read, true, torque = drive(arm, model, seed, noise, count)
        value, sigma = fit(arm, t, read, torque)
        apart.append(value - fit(arm, t, true, torque)[0])
        sigmas.append(sigma)
    return np.asarray(np.mean(apart, axis=0) / np.mean(sigmas, axis=0))


def test_the_noise_of_an_encoder_of_an_arm_puts_nothing_off_by_a_standard_error() -> None:
    assert np.abs(bias_in_standard_errors(1e-4, 0.0, 4)).max() < 1.0


@pytest.mark.slow
def test_counts_of_twelve_bits_do() -> None:
    off = np.abs(bias_in_standard_errors(3e-4, 1.5e-3, 4))
    assert 1.0 < off.max() < 5.0
    assert np.median(off) < 1.0
