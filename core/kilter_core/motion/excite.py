"""Motions that show bodies and friction: sums of sines within limits, from rest to rest, drawn and chosen by what they tell.

Sums of sines: Swevers et al. 1997. Chosen by the determinant of the information on base parameters and friction (D-optimal).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.errors import OptionError
from kilter_core.motion.effects import SIGN_SHARE
from kilter_core.motion.regressor import NO_LIMIT_RAD, base_columns, rigid_regressor
from kilter_core.types import Floats, Ints, Progress, unheard

WAVES = 5
SLOWEST_HZ, FASTEST_HZ = 0.04, 0.35
CANDIDATES = 40
RAMP_S = 4.0  # from rest at the start to the full motion, and back
REST_S = 1.0  # between motions: a search sees there that one ends
SHORTEST_S = 3.0 * RAMP_S
MARGIN = 0.05  # of a joint's range, kept at each end
NO_LIMIT_M = 0.5
REACHED_S = 0.5  # in which a joint may reach its speed
JUDGED_HZ = 10.0
LEAST = 1e-9  # of the largest information, which every direction has beforehand


@dataclass(frozen=True)
class MotionPlan:
    """Motions one after another on one clock: ``t (N,)`` s, ``q (N, n)`` rad or m, and ``motion (N,)``, from 0, -1 at rest.

    ``fastest (n,)`` are the speeds reached. ``condition`` is that of the columns of ``base`` parameters and friction, each
    scaled to one: noise is so many times larger in what is seen worst than in what is seen best.
    """

    t: Floats
    q: Floats
    motion: Ints
    fastest: Floats
    base: int
    condition: float


def plan_motions(
    robot: Robot,
    seconds: float = 40.0,
    count: int = 3,
    rate_hz: float = 50.0,
    speed: tuple[float, float] = (1.0, 0.1),
    seed: int = 0,
    progress: Progress | None = None,
) -> MotionPlan:
    """Return motions of some ``seconds`` each, all from one posture and back to it.

    ``speed`` is the highest of revolute joints, rad/s, and of prismatic ones, m/s.

    Raises:
        OptionError: motions too short to begin and end at rest.

    """
    if seconds < SHORTEST_S:
        raise OptionError(
            f"Motions of {seconds:g} s are too short to begin and end at rest: give {SHORTEST_S:g} s or more.",
            option="seconds",
        )
    progress, rng = progress or unheard, np.random.default_rng(seed)
    kept = base_columns(robot)
    limits = _usable_limits(robot)
    fastest = np.array([speed[joint.kind == "prismatic"] for joint in robot.joints])
    chosen: list[Floats] = []
    size = len(kept) + 3 * robot.n_joints
    known, scale = np.zeros((size, size)), _joint_scale(robot, limits, rng)
    t = np.arange(0.0, seconds, 1.0 / rate_hz)
    for k in range(count):
        best = (-np.inf, np.zeros((0, 0)), np.zeros((0, 0)))
        for c in range(CANDIDATES):
            progress((k + c / CANDIDATES) / count, "motions that tell most")
            q = _draw_motion(rng, t, limits, fastest)
            told = known + _information(robot, kept, t, q, scale)
            d = np.sqrt(np.maximum(np.diag(told), 1e-30))
            score = float(np.linalg.slogdet(told + LEAST * np.diag(d**2))[1])
            if score > best[0]:
                best = score, told, q
        known = best[1]
        chosen.append(best[2])
    return _join_motions(t, chosen, len(kept), _condition(known))


def _usable_limits(robot: Robot) -> Floats:
    """Lowest and highest value (n, 2) of each joint, a little within its limits."""
    widest = np.array([NO_LIMIT_M if joint.kind == "prismatic" else NO_LIMIT_RAD for joint in robot.joints])
    limits = np.clip(robot.limits, -widest[:, None], widest[:, None])
    room = MARGIN * (limits[:, 1] - limits[:, 0])
    return np.asarray(limits + np.stack([room, -room], axis=1))


def _draw_motion(rng: np.random.Generator, t: Floats, limits: Floats, fastest: Floats) -> Floats:
    """Waves (N, n) about a random place, as large as limits and speeds allow; at both ends the middle of the limits."""
    middle, half = limits.mean(axis=1), 0.5 * (limits[:, 1] - limits[:, 0])
    n = len(middle)
    ramp = _ramp(np.minimum(t, t[-1] - t))[:, None]
    shift = rng.uniform(-0.5, 0.5, n) * half
    waves = np.zeros((len(t), n))
    for _ in range(WAVES):
        turns = 2.0 * np.pi * rng.uniform(SLOWEST_HZ, FASTEST_HZ, n)
        waves += rng.uniform(0.2, 1.0, n) * np.sin(np.outer(t, turns) + rng.uniform(0.0, 2.0 * np.pi, n))
    waves *= (half - np.abs(shift)) / np.abs(waves).max(axis=0)
    away = ramp * (shift + waves)
    rate = np.gradient(away, t, axis=0)
    change = np.gradient(rate, t, axis=0)
    over = np.maximum(np.abs(rate).max(axis=0) / fastest, np.abs(change).max(axis=0) * REACHED_S / fastest)
    return np.asarray(middle + away / np.maximum(over, 1.0))


def _ramp(t: Floats) -> Floats:
    """From 0 to 1 within the ramp, speed and acceleration zero at both ends."""
    x = np.clip(t / RAMP_S, 0.0, 1.0)
    return np.asarray(x**3 * (10.0 - 15.0 * x + 6.0 * x**2))


def _joint_scale(robot: Robot, limits: Floats, rng: np.random.Generator) -> Floats:
    """Torque (n,) that bodies of one kilogram make at each joint, so that all joints count alike."""
    shape = (200, robot.n_joints)
    Y = rigid_regressor(
        robot, rng.uniform(limits[:, 0], limits[:, 1], shape), rng.normal(size=shape), rng.normal(size=shape)
    )
    return np.asarray(np.maximum(np.sqrt(np.mean(np.sum(Y**2, axis=2), axis=0)), 1e-9))


def _information(robot: Robot, kept: Ints, t: Floats, q: Floats, scale: Floats) -> Floats:
    """Information (k, k) of a motion on base parameters, and on offset, Coulomb and viscous friction of each joint."""
    thin = slice(None, None, max(1, round((len(t) - 1) / (t[-1] * JUDGED_HZ))))
    qd = np.gradient(q, t, axis=0)
    qdd = np.gradient(qd, t, axis=0)
    q, qd, qdd = q[thin], qd[thin], qdd[thin]
    Y = rigid_regressor(robot, q, qd, qdd)[:, :, kept] / scale[:, None]
    rows, n, base = Y.shape
    columns = np.zeros((rows, n, base + 3 * n))
    columns[:, :, :base] = Y
    usual = np.maximum(SIGN_SHARE * np.quantile(np.abs(qd), 0.95, axis=0), 1e-9)
    for j in range(n):
        columns[:, j, base + 3 * j : base + 3 * (j + 1)] = np.stack(
            [np.ones(rows), np.tanh(qd[:, j] / usual[j]), qd[:, j]], axis=1
        )
    flat = columns.reshape(-1, columns.shape[2])
    return np.asarray(flat.T @ flat)


def _condition(told: Floats) -> float:
    d = np.sqrt(np.maximum(np.diag(told), 1e-30))
    values = np.linalg.eigvalsh(told / np.outer(d, d))
    return float(np.sqrt(values[-1] / max(values[0], 1e-30)))


def _join_motions(t: Floats, chosen: list[Floats], base: int, condition: float) -> MotionPlan:
    step = float(t[1] - t[0])
    rest = round(REST_S / step)
    joints, motion = [], []
    for k, q in enumerate(chosen):
        joints += [np.repeat(q[:1], rest, axis=0), q]
        motion += [np.full(rest, -1), np.full(len(q), k)]
    joints.append(np.repeat(chosen[-1][-1:], rest, axis=0))
    motion.append(np.full(rest, -1))
    q = np.concatenate(joints)
    clock = np.arange(len(q)) * np.float64(step)
    speeds = np.abs(np.gradient(q, step, axis=0)).max(axis=0)
    return MotionPlan(clock, q, np.concatenate(motion), speeds, base, condition)
