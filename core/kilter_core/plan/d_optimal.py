"""Poses to measure: greedy D-optimal choice, by inclinometer, and on the planes of ISO 9283.

Configurations that separate a joint's clearance, backlash and compliance by inclinometer (thesis 4.4.1, 5.3).

Poses on the diagonal planes of the largest cube of the workspace (ISO 9283:1998, 6.8; thesis 3.3 and 4.4.2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from kilter_core.arm.driving_order import driving_order, joint_ranges
from kilter_core.arm.robot import Robot
from kilter_core.effects import Effect
from kilter_core.errors import RobotError
from kilter_core.identify.fleet_prior import FleetVersion, fit_fleet_prior
from kilter_core.identify.options import IdentifyOptions
from kilter_core.model import Calibration, RobotModel
from kilter_core.model.general_inverse import reach
from kilter_core.model.region import Region
from kilter_core.observations import Observations
from kilter_core.observations.groups import with_neutral_conditions
from kilter_core.parameters import Prior, mm
from kilter_core.procedures.inclinometers import AXES, LEAST_MOMENT_NM, UPRIGHT, regressors
from kilter_core.types import Bools, Floats, Ints

POOL = 600


def d_optimal_poses(
    start: Calibration,
    count: int,
    effects: Sequence[Effect] = (),
    noise: float = 5e-5,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    region: Region | None = None,
    payloads_kg: Sequence[float] = (),
    payload_com: Sequence[float] = (),
    fleet: Sequence[FleetVersion] | None = None,
) -> Observations:
    """Rows (count) that maximise the determinant of the information, within the priors, of position measurements.

    ``effects`` are looked for beside those of ``start``; ``noise`` is the standard deviation of a coordinate in m. Poses
    are in ``region`` (within the limits when None), in an order with short moves. A row has ``direction`` where an effect
    needs it, from either side, and ``payload_kg`` where loads matter and ``payloads_kg`` are at hand, at
    ``payload_com`` m in the tool frame; else the robot's default load where loads matter. What ``fleet``, versions of other
    robots of the type, say need not be measured again.

    Raises:
        CoreError: ``fleet_too_few``, ``fleet_gauge``: no prior from these versions.
        RobotError: joint limits are missing, or hardly a pose is in the region.

    """
    rng = np.random.default_rng(seed)
    whole, values, free = looked_for(start, effects)
    needs = whole.needs
    pool = conditions(
        (region or Region.from_calibration(start)).draw(max(POOL, 3 * count), rng), needs, payloads_kg, rng
    )
    pool = with_loads(pool, needs, start.robot, payload_com)
    J = whole.jacobian(with_neutral_conditions(pool, needs), values, free)[1][:, :3]
    sigma, known = _prior_widths_and_correlation(whole, free, fleet)
    chosen = pool.select(most_informative(J * sigma / noise, count, progress, known))
    return chosen.select(driving_order(chosen.q, joint_ranges(start.robot)))


def _prior_widths_and_correlation(
    model: RobotModel, free: Ints, fleet: Sequence[FleetVersion] | None
) -> tuple[Floats, Floats | None]:
    """Widths (P,) of the priors, and their covariance (P, P) in these where other robots of the type say it."""
    parameters = [model.parameters[k] for k in free]
    of_type = None if fleet is None else fit_fleet_prior(model, [p.name for p in parameters], fleet).prior
    prior = Prior.from_parameters(parameters, of_type, model.robot.told_loads)
    return prior.sigma, prior.correlation


def random_poses(robot: Robot, count: int, rng: np.random.Generator) -> Floats:
    """Joints (count, n), uniform within the limits less a margin.

    Raises:
        RobotError: joint limits are missing.

    """
    return Region.from_calibration(Calibration.nominal(robot)).draw(count, rng)


def conditions(
    q: Floats, needs: frozenset[str], payloads_kg: Sequence[float], rng: np.random.Generator
) -> Observations:
    """Rows at ``q``, from either side and under the payloads at hand where an effect feels them."""
    loads = bool(needs & {"moments", "payload_kg"}) and len(payloads_kg) > 0
    return Observations(
        q,
        direction=rng.choice([-1.0, 1.0], q.shape) if "direction" in needs else None,
        payload_kg=rng.choice(np.asarray(payloads_kg, dtype=np.float64), len(q)) if loads else None,
    )


def with_loads(rows: Observations, needs: frozenset[str], robot: Robot, payload_com: Sequence[float]) -> Observations:
    """Rows with their loads where they hang, or under the robot's default load where loads matter and none is at hand."""
    if rows.payload_kg is not None and len(payload_com):
        return replace(rows, payload_com=np.tile(np.asarray(payload_com, dtype=np.float64), (len(rows), 1)))
    if robot.load is None or not needs & {"moments", "payload_kg"}:
        return rows
    return rows.carrying(robot.load.mass, robot.load.com)


def looked_for(start: Calibration, effects: Sequence[Effect]) -> tuple[RobotModel, Floats, Ints]:
    """The start's model with the effects it lacks, its values, and what an identification would free."""
    model, values = start.model.absorb_frame_increments(start.values)
    missing = tuple(effect for effect in effects if not _has(model, effect))
    whole = replace(model, effects=(*model.effects, *missing))
    values = np.concatenate([values, whole.values0()[len(values) :]])
    return whole, values, IdentifyOptions().free_parameters(whole, observes_orientation=False)


def _has(model: RobotModel, effect: Effect) -> bool:
    return bool({p.name for p in effect.parameters(model.robot)} & set(model.names))


def most_informative(
    X: Floats, count: int, progress: Callable[[float], None] | None = None, known: Floats | None = None
) -> Ints:
    """Pick (count,) of N poses by their whitened derivatives ``X (N, r, P)``, parameters in units of their priors.

    ``known (P, P)`` is the covariance of these priors in such units, the identity when None.
    """
    C = np.eye(X.shape[2]) if known is None else known
    picked: list[int] = []
    for k in range(count):
        XC = X @ C
        S = np.eye(X.shape[1]) + XC @ X.transpose(0, 2, 1)
        gain = np.linalg.slogdet(S)[1]
        gain[picked] = -np.inf
        best = int(np.argmax(gain))
        picked.append(best)
        C = C - XC[best].T @ np.linalg.solve(S[best], XC[best])
        if progress is not None:
            progress((k + 1) / count)
    return np.array(picked)


POSTURES_DRAWN = 1500
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
    q = random_poses(robot, POSTURES_DRAWN, rng)
    payload = rng.choice(np.asarray(payloads_kg, dtype=np.float64), POSTURES_DRAWN)
    com = np.tile(np.asarray(payload_com, dtype=np.float64), (POSTURES_DRAWN, 1))
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
