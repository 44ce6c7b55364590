"""Digitised points into a frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from core.conversions import pose_document
from core.errors import ObservationError
from core.reference_frame import frame_of_features, frame_of_points
from service.contract.frames import Frame, NewFrame, OffPoint
from service.contract.units import Pose

MM = 1e-3


def found(frame: NewFrame) -> Frame:
    """Find the frame.

    Raises:
        ObservationError: neither or both kinds of points, or points that make no frame.

    """
    if (frame.points is None) == (frame.features is None):
        raise ObservationError("Give points (known and measured) or features (plane, line, origin), one of the two.")
    if frame.points is not None:
        names = [point.name or str(k) for k, point in enumerate(frame.points, 1)]
        made = frame_of_points(
            _metres([p.known_mm for p in frame.points]), _metres([p.measured_mm for p in frame.points])
        )
    else:
        assert frame.features is not None
        f = frame.features
        names = [f"plane {k}" for k in range(1, len(f.plane_mm) + 1)]
        made = frame_of_features(_metres(f.plane_mm), _metres(f.line_mm), _metres([f.origin_mm])[0])
    left = [OffPoint(name=name, left_mm=float(off) / MM) for name, off in zip(names, made.left, strict=True)]
    return Frame(pose=Pose.model_validate(pose_document(made.pose)), rms_mm=made.rms / MM, points=left)


def _metres(points: list[tuple[float, float, float]]) -> NDArray[np.float64]:
    return np.array(points, dtype=np.float64) * MM
