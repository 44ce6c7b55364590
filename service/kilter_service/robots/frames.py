"""Digitised points into a frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kilter_core.errors import ObservationError
from kilter_service.contract.kinematics import Frame, NewFrame, OffPoint
from kilter_service.contract.units import PointMm, Pose
from kilter_service.ground.core import core_arm, core_procedures
from kilter_service.ground.wire import to_metres, to_mm

if TYPE_CHECKING:
    from kilter_core.procedures import ReferenceFrame


def find_frame(frame: NewFrame) -> Frame:
    """Find the frame.

    Raises:
        ObservationError: neither or both kinds of points, or points that make no frame.

    """
    if (frame.points is None) == (frame.features is None):
        raise ObservationError("Give points (known and measured) or features (plane, line, origin), one of the two.")
    if frame.points is not None:
        names = [point.name or str(k) for k, point in enumerate(frame.points, 1)]
        made = core_procedures.frame_of_points(
            metres([p.known_mm for p in frame.points]), metres([p.measured_mm for p in frame.points])
        )
    else:
        assert frame.features is not None
        f = frame.features
        names = [f"plane {k}" for k in range(1, len(f.plane_mm) + 1)]
        made = core_procedures.frame_of_features(metres(f.plane_mm), metres(f.line_mm), metres([f.origin_mm])[0])
    return describe_frame(made, names)


def metres(points: Sequence[PointMm]) -> NDArray[np.float64]:
    """Return points (N, 3) in m."""
    return to_metres(np.array(points, dtype=np.float64))


def describe_frame(made: ReferenceFrame, names: Sequence[str]) -> Frame:
    """Say where a frame is, and how well its points fit."""
    left = [OffPoint(name=name, left_mm=to_mm(float(off))) for name, off in zip(names, made.left, strict=True)]
    return Frame(pose=Pose.model_validate(core_arm.pose_document(made.pose)), rms_mm=to_mm(made.rms), points=left)
