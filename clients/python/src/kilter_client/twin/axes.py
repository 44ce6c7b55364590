"""Where a robot's base is in somebody's model: the pose by which the axes of both are the same lines at zero joints."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from kilter_client.errors import FileError
from kilter_files.ground.later import np

if TYPE_CHECKING:
    from kilter_files.ground import Floats

NEAR_M, NEAR_RAD = 1e-3, 5e-3  # between an axis of the model and that of the robot, at zero joints
ROUNDS = 60


def base_in_model(
    path: Path, names: Sequence[str], nominal: Floats, anchors: Floats, axes: Floats, start: Floats
) -> Floats:
    """Pose (4, 4) of the robot's base in the model.

    Args:
        path: the model, for messages.
        names: what it calls its joints.
        nominal: frames (n, 4, 4) of the robot's joints, z along the axis of each.
        anchors: points (n, 3) on the axes of the model, m.
        axes: directions (n, 3) of unit length.
        start: a pose (4, 4) to begin at.

    Raises:
        FileError: no such pose: the joint that is farthest off is named.

    """
    T = start
    for _ in range(ROUNDS):
        rows, left = [], []
        for frame, anchor, axis in zip(nominal, anchors, axes, strict=True):
            here, along = T[:3, :3] @ frame[:3, 3] + T[:3, 3], T[:3, :3] @ frame[:3, 2]
            across = np.eye(3) - np.outer(axis, axis)
            rows += [np.hstack([-across @ _skew(here), across]), np.hstack([-_skew(along), np.zeros((3, 3))])]
            left += [across @ (anchor - here), axis - along]
        step = np.linalg.lstsq(np.vstack(rows), np.concatenate(left), rcond=1e-9)[0]
        T = _pose_from_motion(step) @ T
    for name, frame, anchor, axis in zip(names, nominal, anchors, axes, strict=True):
        here = T @ frame
        gap = anchor - here[:3, 3]
        off_m = float(np.linalg.norm(gap - axis * (axis @ gap)))
        off_rad = float(np.arccos(np.clip(axis @ here[:3, 2], -1.0, 1.0)))
        if off_m > NEAR_M or off_rad > NEAR_RAD:
            raise FileError(
                f"{path}: joint {name!r} is {off_m * 1e3:.1f} mm and {np.degrees(off_rad):.1f} deg from where the "
                "robot nominally has it: the model is of another arm, or of another zero. Take the model that the robot "
                "was described by.",
                file=str(path),
            )
    return T


def _skew(v: Floats) -> Floats:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _pose_from_motion(step: Floats) -> Floats:
    """A small motion (w, v) as a pose."""
    T, angle = np.eye(4), float(np.linalg.norm(step[:3]))
    if angle > 0.0:
        K = _skew(step[:3] / angle)
        T[:3, :3] += np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
    T[:3, 3] = step[3:]
    return T
