"""Poses that determine a model's parameters best: greedy D-optimal choice among random poses within the limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from core.effects import Effect
from core.errors import RobotError
from core.identify.options import IdentifyOptions
from core.model import Calibration, RobotModel
from core.observations import Observations
from core.robot import Robot

Floats = NDArray[np.float64]

POOL = 600
BATCH, BATCHES = 20_000, 30  # random poses tried to fill a box
MARGIN_SHARE = 0.03  # of each joint's range kept free at both ends: room for a correction


def d_optimal_poses(
    start: Calibration,
    count: int,
    effects: Sequence[Effect] = (),
    noise: float = 5e-5,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
    box: Floats | None = None,
) -> Floats:
    """Joints (count, n) that maximise the determinant of the information, within the priors, of position measurements.

    ``effects`` are looked for beside those of ``start``; ``noise`` is the standard deviation of a coordinate in m. With a
    ``box (2, 3)`` m, lowest and highest corner in the frame of the measurements, the tool stays in it.

    Raises:
        RobotError: joint limits are missing, or hardly a pose has its tool in the box.

    """
    rng, wanted = np.random.default_rng(seed), max(POOL, 3 * count)
    pool = random_poses(start.robot, wanted, rng) if box is None else poses_within(start, box, wanted, rng)
    X = _information_roots(start, pool, effects, noise)
    C = np.eye(X.shape[2])
    picked: list[int] = []
    for k in range(count):
        XC = X @ C
        S = np.eye(3) + XC @ X.transpose(0, 2, 1)
        gain = np.linalg.slogdet(S)[1]
        gain[picked] = -np.inf
        best = int(np.argmax(gain))
        picked.append(best)
        C = C - XC[best].T @ np.linalg.solve(S[best], XC[best])
        if progress is not None:
            progress((k + 1) / count)
    return pool[picked]


def random_poses(robot: Robot, count: int, rng: np.random.Generator) -> Floats:
    """Joints (count, n), uniform within the limits less a margin.

    Raises:
        RobotError: joint limits are missing.

    """
    low, high = robot.limits.T
    if not np.isfinite(robot.limits).all():
        raise RobotError("Planning poses needs the limits of every joint: give limits_deg.", field="joints")
    margin = MARGIN_SHARE * (high - low)
    return np.asarray(rng.uniform(low + margin, high - margin, (count, robot.n_joints)))


def poses_within(start: Calibration, box: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Joints (count, n) at random within the limits, the tool within the ``box (2, 3)`` m.

    Raises:
        RobotError: joint limits are missing, or fewer than one pose in a thousand has its tool there.

    """
    found: list[Floats] = []
    for _ in range(BATCHES):
        q = random_poses(start.robot, BATCH, rng)
        p = start.predict(Observations(q)).position
        found.append(q[((p >= box[0]) & (p <= box[1])).all(axis=1)])
        if sum(map(len, found)) >= count:
            return np.concatenate(found)[:count]
    raise RobotError(
        f"Of {BATCHES * BATCH} random poses only {sum(map(len, found))} have the tool in the box, {count} are needed: "
        "give a larger box, in the frame of the measurements, or fewer poses.",
        field="box_mm",
    )


def _information_roots(start: Calibration, pool: Floats, effects: Sequence[Effect], noise: float) -> Floats:
    """Derivatives (N, 3, P) of the position by each free parameter's prior sigma, in units of the noise."""
    model, values = start.model.folded(start.values)
    rows = Observations(pool, direction=np.where(np.arange(len(pool))[:, None] % 2, 1.0, -1.0) * np.ones_like(pool))
    missing = tuple(effect for effect in effects if not _has(model, effect))
    whole = RobotModel(model.robot, (*model.effects, *missing), model.T_base, model.T_tool)
    whole_values = np.concatenate([values, whole.values0()[len(values) :]])
    free = IdentifyOptions().free_parameters(whole, sees_orientation=False)
    J = whole.jacobian(rows, whole_values, free)[1][:, :3]
    return np.asarray(J * np.array([whole.parameters[k].prior_sigma for k in free]) / noise)


def _has(model: RobotModel, effect: Effect) -> bool:
    return bool({p.name for p in effect.parameters(model.robot)} & set(model.names))
