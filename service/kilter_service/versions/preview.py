"""How a version would correct where the robot is driven, before it is activated."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kilter_core.observations import Observations
from kilter_service.campaigns import store as campaigns
from kilter_service.contract.previews import VersionPreview
from kilter_service.contract.versions import CorrectionLimits
from kilter_service.correction.wire import options_of
from kilter_service.corrector.wire import Status
from kilter_service.db import Database
from kilter_service.versions import store, wire
from kilter_service.versions.records import Foreseen, VersionRecord

if TYPE_CHECKING:
    from kilter_core.arm.robot import Robot
    from kilter_core.correct.walker import CorrectedTrajectory

Floats = NDArray[np.float64]

MOST_POSES = 2000
DRAWN_POSES = 500
FREE_TURN_RAD, FREE_SHIFT_M = math.pi, 0.5  # of a joint without limits
WIDEST = CorrectionLimits(max_joint_deg=30.0, max_position_mm=200.0)


def preview(database: Database, version_id: str, temperature_c: float | None) -> VersionPreview:
    """Correct the poses that the robot was driven to, else poses drawn within its limits; nothing is stored.

    Raises:
        ServiceError: no such version.

    """
    from kilter_core.correct.walker import correct_trajectory  # loads compiled kernels: not at the start of the process

    with database.reading() as session:
        record = store.get(session, version_id)
        calibration = store.calibration(session, version_id)
        driven = campaigns.driven(session, record.robot_id, calibration.robot, MOST_POSES)
    q = drawn(calibration.robot) if driven is None else driven[:MOST_POSES]
    rows = Observations(q=q)
    wide = correct_trajectory(calibration, rows, options_of(WIDEST, temperature_c))
    narrow = correct_trajectory(calibration, rows, options_of(CorrectionLimits(**record.limits), temperature_c))
    found = _found(record, calibration.robot, rows.q, wide, narrow)
    return wire.preview(found, within="limits" if driven is None else "campaigns", temperature_c=temperature_c)


def drawn(robot: Robot, count: int = DRAWN_POSES) -> Floats:
    """Poses (N, n), rad or m, all over the limits; the same every time."""
    free = np.array([FREE_SHIFT_M if joint.kind == "prismatic" else FREE_TURN_RAD for joint in robot.joints])
    low, high = np.maximum(robot.limits[:, 0], -free), np.minimum(robot.limits[:, 1], free)
    outside = low > high  # limits that lie beyond a full turn
    low, high = np.where(outside, robot.limits[:, 0], low), np.where(outside, robot.limits[:, 1], high)
    return np.random.default_rng(0).uniform(low, high, (count, len(free)))


def _found(
    record: VersionRecord, robot: Robot, q: Floats, wide: CorrectedTrajectory, narrow: CorrectedTrajectory
) -> Foreseen:
    good, taken = wide.status == Status.OK, narrow.status == Status.OK
    moved = np.linalg.norm(wide.error_removed, axis=1)
    worst = int(np.nanargmax(moved)) if good.any() else None
    return Foreseen(
        version_id=record.id,
        robot=robot,
        poses=len(q),
        corrected=int(taken.sum()),
        refused=dict(Counter(Status(int(code)).name for code in narrow.status[~taken].tolist())),
        mean=float(moved[taken].mean()) if taken.any() else None,
        largest=None if worst is None else float(moved[worst]),
        largest_at=None if worst is None else q[worst],
        joints=np.abs(wide.q - q)[good].max(axis=0) if good.any() else None,
        unsupported=list(narrow.not_corrected),
    )
