"""What a version does all over the joint limits of its robot, with the place of each pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from kilter_core.observations import Observations
from kilter_core.types import Floats
from kilter_service.contract.versions import CorrectionLimits
from kilter_service.ground.core import core_identify
from kilter_service.ground.db import Database
from kilter_service.versions import store
from kilter_service.versions.predictions.places import in_base
from kilter_service.versions.predictions.preview import at_poses, drawn
from kilter_service.versions.records import PreviewedPoses

if TYPE_CHECKING:
    from kilter_core.arm import Robot


@dataclass(frozen=True)
class Workspace:
    """Poses all over the joint limits: what the version does there, and the tool (N, 3) m in the robot's base frame."""

    robot: Robot
    limits: CorrectionLimits
    found: PreviewedPoses
    points: Floats


def workspace(database: Database, version_id: str, temperature_c: float | None) -> Workspace:
    """Correct poses drawn within the joint limits as `correct` does.

    Raises:
        ServiceError: no such version.

    """
    with database.reading() as session:
        limits = CorrectionLimits(**store.get(session, version_id).limits)
        calibration, known = store.calibration(session, version_id), store.load_predictive(session, version_id)
    q = drawn(calibration.robot)
    rows = Observations(q=q)
    points = in_base(calibration, core_identify.acting(calibration, rows).predict(rows).position)
    return Workspace(calibration.robot, limits, at_poses(calibration, known, limits, q, temperature_c), points)
