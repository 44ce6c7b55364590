"""The table whose poses come closest to a calibrated arm, and what is lost, over the workspace."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.arm.chain import Chain
from kilter_core.arm.conventions import Row, dh_elements, mdh_elements
from kilter_core.arm.conversions.screws import Screws, chain_frames
from kilter_core.arm.conversions.tables import link_table
from kilter_core.arm.robot import Link, Robot, moved_link
from kilter_core.effects import Effect
from kilter_core.model import Calibration, Prediction, RobotModel
from kilter_core.model.geometry import arm_screws, flange_frames
from kilter_core.observations import Observations
from kilter_core.transforms import inverse, rotation_log
from kilter_core.types import Floats

FREE_SHIFT_M = 0.5  # workspace of a prismatic joint without limits
NOTHING_M = 1e-10
FIT_SIGMA_M = 1e-5
FIT_SIGMA_RAD = 1e-5
FIT_STEPS = 6
AT_REST = frozenset({"moments", "direction"})  # what an effect may need and still act on an arm at rest without load


@dataclass(frozen=True)
class Loss:
    """Distance between two arms over the workspace: position m, orientation rad."""

    rms_m: float
    max_m: float
    max_rad: float


@dataclass(frozen=True)
class ClosestTable:
    """Rows of a DH or MDH table with base and tool (4, 4), and how far the calibrated arm is from them.

    ``links`` are the robot's bodies in the frames of the rows (``element`` counts joints), ``gravity (3,)`` is in ``base``.
    """

    rows: tuple[Row, ...]
    base: Floats
    tool: Floats
    loss: Loss
    links: tuple[Link, ...]
    gravity: Floats


def workspace(robot: Robot, count: int = 400, seed: int = 1) -> Observations:
    """Poses ``count`` spread over the joint limits (one turn, 0.5 m where there are none), each joint moved either way."""
    rng = np.random.default_rng(seed)
    reach = np.array([math.pi if joint.kind == "revolute" else FREE_SHIFT_M for joint in robot.joints])
    lower = np.where(np.isfinite(robot.limits[:, 0]), robot.limits[:, 0], -reach)
    upper = np.where(np.isfinite(robot.limits[:, 1]), robot.limits[:, 1], reach)
    q = rng.uniform(lower, upper, (count, robot.n_joints))
    return Observations(q, direction=rng.choice([-1.0, 1.0], q.shape))


def at_rest(effect: Effect) -> bool:
    """Whether an effect moves an arm that rests without load."""
    return effect.stage != "measurement" and effect.needs <= AT_REST


def arm_poses(calibration: Calibration, rows: Observations) -> Prediction:
    """Tool poses of the whole calibrated arm, at rest without load, seen from the wanted base."""
    kept = calibration.with_effects([effect for effect in calibration.model.effects if at_rest(effect)])
    model, values = kept.model.absorb_frame_increments(kept.values)
    seen_from = inverse(np.asarray(calibration.wanted().model.T_base))
    return replace(model, T_base=seen_from @ np.asarray(model.T_base)).predict(rows, values)


def distance(reference: Prediction, other: Prediction) -> Loss:
    """How far two arms are apart."""
    gap = np.linalg.norm(reference.position - other.position, axis=1)
    turn = np.linalg.norm(rotation_log(reference.rotation.transpose(0, 2, 1) @ other.rotation), axis=1)
    return Loss(float(np.sqrt(np.mean(gap**2))), float(gap.max()), float(turn.max()))


def geometry_loss(calibration: Calibration, arm: Screws | None = None) -> Loss:
    """What is lost when only the geometry (or ``arm``, base to tool) is taken over."""
    rows = workspace(calibration.robot)
    T = (arm or arm_screws(calibration)).poses(rows.q)
    return distance(arm_poses(calibration, rows), Prediction(T[:, :3, 3], T[:, :3, :3]))


def closest_table(calibration: Calibration, convention: str) -> ClosestTable:
    """Table of ``convention`` "dh" or "mdh" closest to the calibrated arm; exact rows when they can be.

    Raises:
        RobotError: a joint drives several axes.

    """
    table = link_table(arm_screws(calibration), hayati=convention == "mdh")
    rows, tool = (table.dh_rows(), table.tool) if convention == "dh" else (table.mdh_rows(), table.mdh_tool())
    model = _model(calibration.robot, rows, convention, table.base, tool)
    conditions = workspace(calibration.robot)
    wanted = arm_poses(calibration, conditions)
    plain = Observations(conditions.q)
    values = model.values0()
    loss = distance(wanted, model.predict(plain, values))
    if loss.max_m > NOTHING_M:
        fitted = _fitted(model, plain, wanted, values)
        closer = distance(wanted, model.predict(plain, fitted))
        values, loss = (fitted, closer) if closer.rms_m < loss.rms_m else (values, loss)
    model, values = model.absorb_frame_increments(values)
    named = dict(zip(model.names, values.tolist(), strict=True))
    found, base = _rows(rows, named), np.asarray(model.T_base)
    frames = flange_frames(calibration).elements
    gravity = base[:3, :3].T @ frames[0][:3, :3] @ calibration.robot.gravity
    links = _links(calibration.robot, frames, found, convention, base)
    return ClosestTable(found, base, np.asarray(model.T_tool), loss, links, gravity)


def _links(robot: Robot, frames: Floats, rows: tuple[Row, ...], convention: str, base: Floats) -> tuple[Link, ...]:
    """Bodies of the arm, with all joints at zero, in the frames of the table's rows."""
    elements, at = (dh_elements if convention == "dh" else mdh_elements)(rows)
    table = base @ chain_frames(Chain(elements, len(rows)))
    return tuple(
        replace(moved_link(link, inverse(table[at[j] + 1]) @ frames[link.element + 1]), element=j)
        for j, link in enumerate(robot.links)
    )


def _model(robot: Robot, rows: Sequence[Row], convention: str, base: Floats, tool: Floats) -> RobotModel:
    elements, _ = (dh_elements if convention == "dh" else mdh_elements)(rows)
    return RobotModel(Robot(robot.name, robot.joints, Chain(elements, len(rows))), (), base, tool)


def _fitted(model: RobotModel, rows: Observations, wanted: Prediction, values: Floats) -> Floats:
    """Gauss-Newton from the exact geometry; the priors keep unobservable parameters at their values."""
    # A table without β must not get one.
    fixed = {f"beta_{k + 1}" for k in range(model.robot.n_joints)} - {p.name for p in model.parameters if p.value}
    free = np.array([k for k, name in enumerate(model.names) if name not in fixed])
    prior = np.array([model.parameters[k].prior_sigma for k in free])
    for _ in range(FIT_STEPS):
        found, J = model.jacobian(rows, values, free)
        turn = rotation_log(wanted.rotation @ found.rotation.transpose(0, 2, 1)) / FIT_SIGMA_RAD
        error = np.hstack([(wanted.position - found.position) / FIT_SIGMA_M, turn]).ravel()
        weight = np.array([FIT_SIGMA_M] * 3 + [FIT_SIGMA_RAD] * 3)
        A = (J / weight[None, :, None]).reshape(len(error), -1)
        values = values.copy()
        values[free] += np.linalg.solve(A.T @ A + np.diag(prior**-2), A.T @ error)
    return values


def _rows(rows: Sequence[Row], named: dict[str, float]) -> tuple[Row, ...]:
    return tuple(
        replace(
            row,
            alpha=named[f"alpha_{k}"],
            a=named[f"a_{k}"],
            theta_offset=named[f"theta_offset_{k}"],
            d=None if row.d is None else named[f"d_{k}"],
            beta=None if row.beta is None else named[f"beta_{k}"],
        )
        for k, row in enumerate(rows, 1)
    )
