"""A frame on each axis: what URDF and MATLAB's rigidBodyTree are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.conversions.screws import Screws
from kilter_core.transforms import align_z_axis, inverse
from kilter_core.types import Floats


@dataclass(frozen=True)
class JointFrames:
    """``origin (M, 4, 4)`` of each axis in the frame before, z along the axis, and ``end (4, 4)`` from the last to the tip."""

    origin: Floats
    end: Floats


def joint_frames(screws: Screws) -> JointFrames:
    """Frames on the axes at zero, as near as they can be to those before: the tip's first, so plain arms stay plain."""
    T, origins = np.eye(4), []
    for direction, point in zip(screws.direction, screws.point, strict=True):
        frame = np.eye(4)
        frame[:3, :3] = align_z_axis(T[:3, :3], direction)
        frame[:3, 3] = point
        origins.append(inverse(T) @ frame)
        T = frame
    return JointFrames(np.array(origins), inverse(T) @ screws.home)
