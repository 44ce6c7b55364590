"""Poses on the diagonal planes of the largest cube of the workspace (ISO 9283:1998, 6.8; thesis 3.3 and 4.4.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from kilter_core.arm.robot import Robot
from kilter_core.errors import RobotError
from kilter_core.model import RobotModel
from kilter_core.model.general_inverse import reach
from kilter_core.model.region import Region
from kilter_core.observations import Observations
from kilter_core.parameters import mm
from kilter_core.types import Bools, Floats

SAMPLES = 20_000
GRID = 9
PLANES = ((0, 1, 1), (0, 1, -1), (1, 0, 1), (1, 0, -1))  # directions in the diagonal planes, beside the axis left out
INWARD = 0.4  # of the side: from the centre to a tenth of the diagonal from its end
SMALLER, TRIES = 0.9, 8  # of a cube whose five poses cannot all be reached
CANDIDATES = 6  # configurations tried per point; the one whose least-moved joint moves most follows the last pose


@dataclass(frozen=True)
class Cube:
    """An axis-parallel cube, ``centre (3,)`` and ``side``, m, in the frame of the robot's base pose."""

    centre: Floats
    side: float

    def on_diagonals(self, count: int, rng: np.random.Generator) -> Floats:
        """Points (count, 3) spread over the four diagonal planes in turn."""
        u, v = rng.uniform(-0.5, 0.5, (2, count))
        planes = np.array(PLANES)[np.arange(count) % 4]
        along = planes * v[:, None]
        across = np.where(planes == 0, u[:, None], 0.0)
        return np.asarray(self.centre + self.side * (along + across))

    def five(self, plane: int = 0) -> Floats:
        """Points P1 to P5 (5, 3) of 6.8.2 on one of the four diagonal planes.

        P1 is the centre, the others lie a tenth of the plane's diagonals from their ends; P2 and P4 are opposite.
        """
        u = np.array([0.0, 1.0, -1.0, -1.0, 1.0])[:, None]
        v = np.array([0.0, 1.0, 1.0, -1.0, -1.0])[:, None]
        along = np.array(PLANES[plane]) * v
        across = np.where(np.array(PLANES[plane]) == 0, u, 0.0)
        return np.asarray(self.centre + INWARD * self.side * (along + across))


def iso_poses(robot: Robot, count: int = 118, seed: int = 0, region: Region | None = None) -> Floats:
    """Joints (count, n) of poses on the diagonal planes of the largest cube, every joint moving between poses.

    Poses, and the cube, keep to the floor and the box of ``region``.

    Raises:
        RobotError: joint limits are missing, or no cube of the workspace can be reached.

    """
    samples, points = _workspace(robot, seed, region)
    cube = largest_cube(points)
    rng = np.random.default_rng(seed)
    tree = KDTree(points)
    poses: list[Floats] = []
    while len(poses) < count:
        targets = cube.on_diagonals(4 * count, rng)
        near = tree.query(targets, k=CANDIDATES)[1]
        q, arrived = reach(robot, np.repeat(targets, CANDIDATES, axis=0), samples[near.reshape(-1)])
        arrived = arrived & _clear(region, q)
        found = len(poses)
        for mine, ok in zip(q.reshape(-1, CANDIDATES, robot.n_joints), arrived.reshape(-1, CANDIDATES), strict=True):
            if len(poses) < count and ok.any():
                poses.append(_moving_most(mine[ok], poses, robot))
        if len(poses) == found:
            raise RobotError(f"No pose in the cube of {mm(cube.side):.0f} mm can be reached: check the joint limits.")
    return np.array(poses)


def five_poses(robot: Robot, plane: int = 0, seed: int = 0, region: Region | None = None) -> Floats:
    """Joints (5, n) of P1 to P5 on a diagonal plane of the largest cube, in which all five can be reached.

    They keep to the floor and the box of ``region``.

    Visited from P5 down to P1, every joint moves between them where the arm allows it.

    Raises:
        RobotError: joint limits are missing, or no cube has five poses that can be reached.

    """
    samples, points = _workspace(robot, seed, region)
    cube, tree = largest_cube(points), KDTree(points)
    for _ in range(TRIES):
        near = tree.query(cube.five(plane), k=4 * CANDIDATES)[1]
        targets = np.repeat(cube.five(plane), 4 * CANDIDATES, axis=0)
        q, arrived = reach(robot, targets, samples[near.reshape(-1)])
        arrived = arrived & _clear(region, q)
        tried, ok = q.reshape(5, -1, robot.n_joints), arrived.reshape(5, -1)
        if ok.any(axis=1).all():
            visited: list[Floats] = []
            for k in (4, 3, 2, 1, 0):
                visited.append(_moving_most(tried[k][ok[k]], visited, robot))
            return np.array(visited[::-1])
        cube = Cube(cube.centre, SMALLER * cube.side)
    raise RobotError("No cube of this robot has five poses that can be reached: check lengths and joint limits.")


def largest_cube(points: Floats) -> Cube:
    """Largest cube whose corners, faces and centre lie within the cloud of reachable points (N, 3).

    Raises:
        RobotError: none does.

    """
    tree = KDTree(points)
    low, high = np.percentile(points, [2, 98], axis=0)
    spacing = float(np.min(high - low)) / 25.0
    offsets = np.stack(np.meshgrid(*[[-0.5, 0.0, 0.5]] * 3), axis=-1).reshape(-1, 3)
    centres = np.stack(np.meshgrid(*[np.linspace(a, b, GRID) for a, b in zip(low, high, strict=True)]), -1).reshape(
        -1, 3
    )
    for side in np.linspace(0.6, 0.05, 23) * float(np.max(high - low)):
        gaps = np.asarray(tree.query(centres[:, None, :] + side * offsets)[0]).max(axis=1)
        best = int(np.argmin(gaps))
        if gaps[best] < spacing:
            return Cube(centres[best], float(side))
    raise RobotError("No cube fits into the workspace: check lengths and joint limits.")


def _clear(region: Region | None, q: Floats) -> Bools:
    return np.ones(len(q), dtype=bool) if region is None else region.clear(q)


def _workspace(robot: Robot, seed: int, region: Region | None) -> tuple[Floats, Floats]:
    limits = robot.limits
    if not np.isfinite(limits).all():
        raise RobotError("ISO 9283 poses need the limits of every joint: give limits_deg.", field="joints")
    samples = np.random.default_rng(seed).uniform(limits[:, 0], limits[:, 1], (SAMPLES, robot.n_joints))
    samples = samples[_clear(region, samples)]
    if len(samples) < 0.001 * SAMPLES:
        raise RobotError("Hardly a pose keeps to the floor and the box: give more room.", field="box_mm")
    model = RobotModel(robot)
    return samples, model.predict(Observations(samples), model.values0()).position


def _moving_most(choices: Floats, poses: list[Floats], robot: Robot) -> Floats:
    if not poses:
        return np.asarray(choices[0])
    moved = np.abs(choices - poses[-1]) / np.ptp(robot.limits, axis=1)
    return np.asarray(choices[np.argmax(moved.min(axis=1))])
