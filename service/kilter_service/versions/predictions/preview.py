"""What a version does where the robot is driven, before it is activated: the correction itself, at those poses.

:func:`over_poses` is for whoever decides by it, such as the guard of activation; :func:`preview` says it over the wire.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np

from kilter_core.observations import Observations
from kilter_core.types import Floats
from kilter_service.campaigns import store as campaigns
from kilter_service.contract.versions import CorrectionLimits, VersionPreview
from kilter_service.ground import correction_outcome as outcome
from kilter_service.ground.correction_limits import correction_options
from kilter_service.ground.db import Database
from kilter_service.versions import store, wire
from kilter_service.versions.records import PreviewedPoses

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.identify import Predictive
    from kilter_core.model import Calibration

Within = Literal["campaigns", "limits"]

MOST_POSES = 2000
DRAWN_POSES = 500
FREE_TURN_RAD, FREE_SHIFT_M = math.pi, 0.5  # of a joint without limits


def preview(database: Database, version_id: str, temperature_c: float | None) -> VersionPreview:
    """Say what a version does over the robot's poses; nothing is stored.

    Raises:
        ServiceError: no such version.

    """
    robot, within, found = over_poses(database, version_id, temperature_c)
    return wire.preview(version_id, robot, found, within, temperature_c)


def over_poses(
    database: Database, version_id: str, temperature_c: float | None
) -> tuple[Robot, Within, PreviewedPoses]:
    """Correct the poses that the robot was driven to ("campaigns"), else poses drawn within its joint limits ("limits").

    Raises:
        ServiceError: no such version.

    """
    with database.reading() as session:
        record = store.get(session, version_id)
        calibration, known = store.calibration(session, version_id), store.load_predictive(session, version_id)
        driven = campaigns.driven(session, record.robot_id, calibration.robot, MOST_POSES)
    q = drawn(calibration.robot) if driven is None else driven[:MOST_POSES]
    found = at_poses(calibration, known, CorrectionLimits(**record.limits), q, temperature_c)
    return calibration.robot, "limits" if driven is None else "campaigns", found


def at_poses(
    calibration: Calibration,
    known: Predictive | None,
    limits: CorrectionLimits,
    q: Floats,
    temperature_c: float | None = None,
) -> PreviewedPoses:
    """Correct poses ``q (N, n)`` as `correct` corrects a file of them without times, within these limits."""
    found = outcome.correct(calibration, Observations(q=q), correction_options(limits, temperature_c), known)
    with np.errstate(over="ignore"):  # a version of nonsense moves the tool beyond all numbers
        moved = np.linalg.norm(found.done.error_removed, axis=1)
    return PreviewedPoses(
        q=q,
        words=tuple(found.words),
        moved=moved,
        left=found.remaining_errors,
        delta=found.done.q - q,
        unsupported=found.done.not_corrected,
        where_stated=found.done.where_stated,
    )


def drawn(robot: Robot, count: int = DRAWN_POSES) -> Floats:
    """Poses (N, n), rad or m, all over the limits; the same every time."""
    free = np.array([FREE_SHIFT_M if joint.kind == "prismatic" else FREE_TURN_RAD for joint in robot.joints])
    low, high = np.maximum(robot.limits[:, 0], -free), np.minimum(robot.limits[:, 1], free)
    outside = low > high  # limits that lie beyond a full turn
    low, high = np.where(outside, robot.limits[:, 0], low), np.where(outside, robot.limits[:, 1], high)
    return np.random.default_rng(0).uniform(low, high, (count, len(free)))
