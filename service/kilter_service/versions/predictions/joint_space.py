"""Errors of the tool as motions of the joints: the smallest ones that would explain them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kilter_core.types import Floats
from kilter_service.campaigns import store as campaigns
from kilter_service.ground.core import core_arm
from kilter_service.ground.db import Database
from kilter_service.robots import store as robots
from kilter_service.versions import store
from kilter_service.versions.predictions.places import places

if TYPE_CHECKING:
    from kilter_core.model import Calibration

DAMPING_M = 1e-3  # m/rad: near a singular pose no joint is asked to move without bound


def joint_errors(database: Database, version: str, campaign: str) -> Floats:
    """Return for each of the rows of :func:`places` (N, n) the least motion of the joints, rad or m, that its error is.

    Raises:
        ServiceError: as :func:`places`.

    """
    found = places(database, version, campaign)
    with database.reading() as session:
        calibration = store.calibration(session, version)
        robot = robots.core_robot(session, campaigns.whole(session, campaign).robot_id)
        rows = campaigns.observations(session, campaign, robot).select(found.row - 1)
    _, jacobian = calibration.model.joint_jacobian(rows, calibration.values)
    return least_motion(_in_base(calibration, jacobian[:, :3]), found.left["identified"])


def least_motion(jacobian: Floats, error: Floats) -> Floats:
    """Motions (N, n) of the joints of least length that move tools by errors (N, 3) m; ``jacobian (N, 3, n)`` m/rad."""
    square = jacobian @ jacobian.transpose(0, 2, 1) + DAMPING_M**2 * np.eye(3)
    return np.asarray((jacobian.transpose(0, 2, 1) @ np.linalg.solve(square, error[:, :, None]))[:, :, 0])


def _in_base(calibration: Calibration, jacobian: Floats) -> Floats:
    """Derivatives (N, 3, n) of measured positions in the axes of the robot's base."""
    turn = (calibration.model.T_base @ core_arm.increment(calibration.values[:6]))[:3, :3]
    return np.asarray(turn.T @ jacobian)
