"""Digitised points into a frame."""

from __future__ import annotations

from kilter_core.errors import ObservationError
from kilter_service.contract.frames import Frame, NewFrame
from kilter_service.ground.core import core_procedures
from kilter_service.robots.frames import wire


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
            wire.metres([p.known_mm for p in frame.points]), wire.metres([p.measured_mm for p in frame.points])
        )
    else:
        assert frame.features is not None
        f = frame.features
        names = [f"plane {k}" for k in range(1, len(f.plane_mm) + 1)]
        made = core_procedures.frame_of_features(
            wire.metres(f.plane_mm), wire.metres(f.line_mm), wire.metres([f.origin_mm])[0]
        )
    return wire.frame(made, names)
