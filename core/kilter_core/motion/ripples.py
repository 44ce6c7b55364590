"""Torque that repeats with the angle of a joint: how often per turn, before anything else about it is known."""

from __future__ import annotations

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.motion.fit import Fit
from kilter_core.motion.normal import Equations
from kilter_core.motion.record import Log
from kilter_core.types import Floats

MOST_ROWS = 20_000
FEWEST_ROWS = 50
FEWEST_PERIODS = 4.0  # of a ripple that a joint must have passed
LOWEST, HIGHEST = 3, 400  # per turn; slower ones are curves of the joint
BAND_SHARE = 0.8  # of the cut-off: faster ripples are filtered away at the joint's usual speed


def orders_tried(robot: Robot, j: int, speed: float, cut_off_hz: float) -> Floats:
    """Orders per turn that can be seen at a joint: whole ones, and those of its gear."""
    highest = min(HIGHEST, BAND_SHARE * cut_off_hz * 2.0 * np.pi / max(0.5 * speed, 1e-6))
    whole = np.arange(LOWEST, max(LOWEST, int(highest)), dtype=np.float64)
    ratio = robot.joints[j].gear_ratio
    return whole if ratio is None else np.unique(np.concatenate([whole, [abs(ratio), 2.0 * abs(ratio)]]))


def find_orders(log: Log, equations: Equations, fit: Fit) -> tuple[tuple[float | None, ...], int]:
    """Return the order at which what a fit leaves of each joint repeats most, None where none can be seen, and how many
    were tried in all.
    """
    robot = equations.layout.robot
    best: list[float | None] = []
    tried = 0
    for j, (q, left) in enumerate(_list_residuals(log, equations, fit)):
        orders = np.zeros(0)
        if len(q) >= FEWEST_ROWS and robot.joints[j].kind == "revolute":
            orders = orders_tried(robot, j, float(equations.layout.speeds[j]), log.cut_off_hz)
            orders = orders[orders * np.ptp(q) > FEWEST_PERIODS * 2.0 * np.pi]
        tried += len(orders)
        power = [_measure_ripple(order, q, left) for order in orders.tolist()]
        best.append(float(orders[int(np.argmax(power))]) if power else None)
    return tuple(best), tried


def _measure_ripple(order: float, q: Floats, r: Floats) -> float:
    waves = np.stack([np.sin(order * q), np.cos(order * q)], axis=1)
    along = waves.T @ r
    return float(along @ np.linalg.pinv(waves.T @ waves) @ along)


def _list_residuals(log: Log, equations: Equations, fit: Fit) -> list[Floats]:
    """Angles and what is left of the torques (2, N) of each joint where it moves."""
    layout, rows = equations.layout, 0
    found: list[list[Floats]] = [[] for _ in equations.products]
    for part in log.parts():
        bodies, use = layout.bodies(part), (part.moving & part.usable)[part.rows]
        for j, one in enumerate(found):
            model = layout.joint_columns(part, bodies, j, None) @ fit.theta[equations.places[j]]
            left = part.smooth(part.tau[:, j] - bodies.stated[:, j] - model)
            one.append(np.stack([part.q[part.rows, j], left])[:, use[:, j]])
        rows += len(use)
        if rows > MOST_ROWS:
            break
    return [np.concatenate(one, axis=1) for one in found]
