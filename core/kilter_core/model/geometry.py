"""The geometric part of a calibration as an arm of its own, and errors of axes that no parameter can express."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.conversions.tables import Screws, chain_frames, screws_of_chain
from kilter_core.arm.robot import Robot
from kilter_core.model.calibration import Calibration
from kilter_core.model.robot_model import RobotModel
from kilter_core.observations import Observations
from kilter_core.transforms import inverse
from kilter_core.types import Floats, Ints


@dataclass(frozen=True)
class FlangeFrames:
    """``elements (E + 1, 4, 4)``: poses of the identified chain at zero, before the first and after each element, in the
    robot's base frame; ``end (4, 4)`` from the last to the identified flange.
    """

    elements: Floats
    end: Floats


def arm_screws(calibration: Calibration) -> Screws:
    """Base to tool point: the identified chain between the identified frames, seen from the wanted base.

    What the wanted and the identified frames differ by is part of the arm's error, so it stays in the arm.
    """
    model, constants = _absorb_frames(calibration)
    return screws_of_chain(model.robot.chain, constants).compose_with_poses(
        _base_in_wanted_frame(calibration, model), np.asarray(model.T_tool)
    )


def flange_screws(calibration: Calibration) -> Screws:
    """Base to flange: a drop-in for the nominal chain; with the controller's tool frame behind it, the tool is right."""
    return arm_screws(calibration).compose_with_poses(np.eye(4), inverse(wanted_tool(calibration)))


def flange_frames(calibration: Calibration) -> FlangeFrames:
    """The same arm, element by element."""
    model, constants = _absorb_frames(calibration)
    elements = _base_in_wanted_frame(calibration, model) @ chain_frames(model.robot.chain, constants)
    return FlangeFrames(elements, np.asarray(model.T_tool) @ inverse(wanted_tool(calibration)))


def wanted_tool(calibration: Calibration) -> Floats:
    """The tool frame (4, 4) that the controller has."""
    return np.asarray(calibration.nominal_in_wanted_frames().model.T_tool)


def _absorb_frames(calibration: Calibration) -> tuple[RobotModel, Floats]:
    model, values = calibration.model.absorb_frame_increments(calibration.values)
    return model, values[6 : model.n_geometric - 6]


def _base_in_wanted_frame(calibration: Calibration, model: RobotModel) -> Floats:
    return np.asarray(
        inverse(np.asarray(calibration.nominal_in_wanted_frames().model.T_base)) @ np.asarray(model.T_base)
    )


POSES = 40
FREE = 1.0  # rad or m to either side, of a joint without limits
LEFT = 1e-6  # of a column, below which nothing of it is left beside others


def missing_directions(robot: Robot) -> Ints:
    """Count the directions (n,) of pose error about each joint's axes that no named constant has.

    A small motion of a link is one of six; of R revolute and P prismatic axes 4 R + 2 P + 6 differ (Mooring, Roth and
    Driels, Fundamentals of Manipulator Calibration, 1991). A motion of the link before an axis that is not in the span of
    the parameters' columns, nor of motions of links before, is missing at that axis' joint.
    """
    calibration = Calibration.nominal(robot)
    q = _scattered_joints(robot)
    screws = arm_screws(calibration).compose_with_poses(robot.T_base, np.eye(4))
    tool = screws.poses(q)[:, :3, 3]
    size = float(np.ptp(tool, axis=0).max()) or 1.0
    geometric = np.arange(calibration.model.n_geometric)
    known = calibration.model.jacobian(Observations(q), calibration.values, geometric)[1]
    basis = _orthonormal_basis(_rows(known, size))
    missing = np.zeros(robot.n_joints, dtype=np.int64)
    for axis, frames in zip(range(len(screws)), screws.link_motions(q), strict=False):
        motions = _rows(_link_columns(frames, tool, size), size)
        motions /= np.linalg.norm(motions, axis=0)
        more = _orthonormal_basis(motions - basis @ (basis.T @ motions), scale=1.0)
        missing[screws.joint[axis]] += more.shape[1]
        basis = np.hstack([basis, more])
    return missing


def _scattered_joints(robot: Robot) -> Floats:
    lower, upper = (
        np.where(np.isfinite(side), side, sign * FREE) for side, sign in zip(robot.limits.T, (-1, 1), strict=True)
    )
    return np.random.default_rng(0).uniform(lower, upper, (POSES, robot.n_joints))


def _link_columns(frames: Floats, tool: Floats, size: float) -> Floats:
    """Derivatives (N, 6, 6) of the tool's position and rotation by motions of a link that ``frames (N, 4, 4)`` carry."""
    R, p = frames[:, :3, :3], frames[:, :3, 3]
    turned = np.cross(R.transpose(0, 2, 1), (tool - p)[:, None]).transpose(0, 2, 1)
    return np.concatenate(
        [np.concatenate([size * R, turned], axis=2), np.concatenate([np.zeros_like(R), R], axis=2)], axis=1
    )


def _rows(columns: Floats, size: float) -> Floats:
    """Columns (6 N, K) with lengths in units of the arm's size."""
    scale = np.repeat([1.0 / size, 1.0], 3)[:, None]
    return np.asarray((columns * scale).reshape(-1, columns.shape[2]))


def _orthonormal_basis(columns: Floats, scale: float | None = None) -> Floats:
    if scale is None:
        norms = np.linalg.norm(columns, axis=0)
        columns, scale = columns[:, norms > 0.0] / norms[norms > 0.0], 1.0
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(U[:, s > LEFT * scale])
