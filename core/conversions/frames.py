"""A frame on each axis: what URDF and MATLAB's rigidBodyTree are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.conversions.screws import Screws
from core.transforms import inverse

Floats = NDArray[np.float64]


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
        frame[:3, :3] = aligned(T[:3, :3], direction)
        frame[:3, 3] = point
        origins.append(inverse(T) @ frame)
        T = frame
    return JointFrames(np.array(origins), inverse(T) @ screws.home)


def aligned(R: Floats, z: Floats) -> Floats:
    """Rotation (3, 3) with this z axis, turned as little as possible from ``R``."""
    # A rotation by half a turn has no nearest: then the frame is turned about its own x.
    x = R[:, 0] - z * (R[:, 0] @ z)
    if np.linalg.norm(x) < 0.5:
        y = R[:, 1] - z * (R[:, 1] @ z)
        y /= np.linalg.norm(y)
        return np.column_stack([np.cross(y, z), y, z])
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def xyz_rpy(T: Floats) -> tuple[Floats, Floats]:
    """Position (3,) m and roll, pitch, yaw (3,) rad of a pose, exact to rounding at and near pitch 90 degrees too."""
    R = T[:3, :3]
    yaw = float(np.arctan2(R[1, 0], R[0, 0])) if np.hypot(R[0, 0], R[1, 0]) > 1e-15 else 0.0
    c, s = np.cos(yaw), np.sin(yaw)
    # Near pitch 90 degrees yaw is rounding noise; what is taken off as yaw comes back as roll.
    rest = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ R
    roll = float(np.arctan2(-rest[1, 2], rest[1, 1]))
    return T[:3, 3].copy(), np.array([roll, float(np.arctan2(-rest[2, 0], rest[0, 0])), yaw])
