"""The order in which planned poses are driven: with short moves from one to the next."""

from __future__ import annotations

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.types import Floats, Ints

PASSES = 20
ENOUGH = 1e-9


def joint_ranges(robot: Robot) -> Floats:
    """How far (n,) each joint may go, rad or m; one turn at most."""
    return np.asarray(np.ptp(np.clip(robot.limits, -np.pi, np.pi), axis=1))


def driving_order(q: Floats, ranges: Floats) -> Ints:
    """Order (N,) of joint vectors ``q (N, n)`` in which the arm moves little.

    A move costs what its slowest joint needs, as a share of that joint's ``ranges (n,)``. Nearest neighbour from the
    first pose, then exchanges of two moves (2-opt; Croes 1958) until none shortens the path.
    """
    if len(q) < 3:
        return np.arange(len(q))
    scaled = q / np.where(ranges > 0.0, ranges, 1.0)
    cost = np.abs(scaled[:, None] - scaled[None]).max(axis=2)
    order = _nearest(cost)
    for _ in range(PASSES):
        if not _run_two_opt_pass(cost, order):
            break
    return order


def _nearest(cost: Floats) -> Ints:
    left = np.ones(len(cost), dtype=bool)
    order = [0]
    left[0] = False
    while left.any():
        nearest = int(np.argmin(np.where(left, cost[order[-1]], np.inf)))
        order.append(nearest)
        left[nearest] = False
    return np.array(order, dtype=np.int64)


def _run_two_opt_pass(cost: Floats, order: Ints) -> bool:
    """Reverse parts of the path, in place, where that shortens it; the last part may end anywhere."""
    better = False
    for i in range(len(order) - 2):
        a, b = order[i], order[i + 1 :]
        now = cost[a, b[0]] + np.r_[cost[b[:-1], b[1:]], 0.0]
        then = cost[a, b] + np.r_[cost[b[0], b[1:]], 0.0]
        k = int(np.argmax(now - then))
        if now[k] - then[k] > ENOUGH:
            order[i + 1 : i + 2 + k] = order[i + 1 : i + 2 + k][::-1]
            better = True
    return better
