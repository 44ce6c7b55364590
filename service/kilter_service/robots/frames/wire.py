"""Frames as they go over the wire, in mm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kilter_service.contract.frames import Frame, OffPoint
from kilter_service.contract.units import PointMm, Pose
from kilter_service.ground.core import core_arm

if TYPE_CHECKING:
    from kilter_core.procedures import ReferenceFrame

MM = 1e-3


def metres(points: Sequence[PointMm]) -> NDArray[np.float64]:
    """Return points (N, 3) in m."""
    return np.array(points, dtype=np.float64) * MM


def frame(made: ReferenceFrame, names: Sequence[str]) -> Frame:
    """Say where a frame is, and how well its points fit."""
    left = [OffPoint(name=name, left_mm=float(off) / MM) for name, off in zip(names, made.left, strict=True)]
    return Frame(pose=Pose.model_validate(core_arm.pose_document(made.pose)), rms_mm=made.rms / MM, points=left)
