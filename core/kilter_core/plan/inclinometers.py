"""Configurations that separate a joint's clearance, backlash and compliance by inclinometer (thesis 4.4.1, 5.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.errors import RobotError
from kilter_core.observations import Observations
from kilter_core.plan.d_optimal import random_poses
from kilter_core.procedures.inclinometers import AXES, LEAST_MOMENT_NM, UPRIGHT, regressors
from kilter_core.types import Floats

POOL = 1500
PRIOR = np.array([2e-3, 2e-3, 2e-4])  # of C and b in rad, c in rad/(N m)
NOISE_RAD = 2e-5  # of one reading: the resolution of 0.001 deg


@dataclass(frozen=True)
class Configuration:
    """Where to take a reading: joints (n,), payload and the axis (0 x, 1 y, 2 z) of the joint frame."""

    q: Floats
    payload_kg: float
    joint: int
    axis: int


def inclinometer_poses(
    robot: Robot,
    joint: int,
    count: int = 8,
    payloads_kg: Sequence[float] = (0.0,),
    seed: int = 0,
    payload_com: Sequence[float] = (0.0, 0.0, 0.0),
) -> list[Configuration]:
    """Readings of one joint, greedily D-optimal for its three parameters and the offsets of the axes.

    Payloads hang at ``payload_com`` m in the tool frame.

    Raises:
        RobotError: limits are missing, or gravity has no moment about the joint: it must be measured at the end effector.

    """
    rng = np.random.default_rng(seed)
    q = random_poses(robot, POOL, rng)
    payload = rng.choice(np.asarray(payloads_kg, dtype=np.float64), POOL)
    com = np.tile(np.asarray(payload_com, dtype=np.float64), (POOL, 1))
    whole, upright = regressors(robot, Observations(q, payload_kg=payload, payload_com=com))
    if np.max(np.abs(whole[:, joint, 2, 2])) < LEAST_MOMENT_NM:
        raise RobotError(
            f"Gravity has no moment about joint {robot.joints[joint].name}: an inclinometer cannot measure it. Take tool "
            "positions with a payload or a sideways force instead (thesis 4.4.1).",
            field="joints",
        )
    row, axis = np.nonzero(np.abs(upright[:, joint]) < UPRIGHT)
    X = np.hstack([whole[row, joint, axis] * PRIOR, np.eye(len(AXES))[axis] * PRIOR[0]]) / NOISE_RAD
    return [Configuration(q[row[i]], float(payload[row[i]]), joint, int(axis[i])) for i in _greedy(X, count)]


def _greedy(X: Floats, count: int) -> list[int]:
    """Rows of ``X (N, P)`` that raise the determinant of the information most, one after the other."""
    C, picked = np.eye(X.shape[1]), list[int]()
    for _ in range(count):
        XC = X @ C
        gain = np.einsum("np,np->n", XC, X)
        gain[picked] = -np.inf
        best = int(np.argmax(gain))
        picked.append(best)
        C = C - np.outer(XC[best], XC[best]) / (1.0 + gain[best])
    return picked
