"""Poses from three or more markers on the tool: the shape they share, and its rigid fit to each row."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from core.errors import ObservationError
from core.transforms import nearest_rotation

Floats = NDArray[np.float64]


def marker_shape(markers: Floats) -> Floats:
    """Common shape (m, 3) m of rigid marker sets (N, m, 3), in its own frame.

    Origin at the mean marker, z normal to the first three, x along the line from their middle to marker 1. The shape
    is the mean of all complete rows after a rigid alignment to each other (generalised Procrustes), so its noise is
    that of one row over sqrt(N).

    Raises:
        ObservationError: no row shows every marker, fewer than three markers, or markers in one line.

    """
    if markers.shape[1] < 3:
        raise ObservationError(f"{markers.shape[1]} markers do not fix a pose: three or more, not in line, are needed.")
    complete = markers[~np.isnan(markers).any(axis=(1, 2))]
    if len(complete) == 0:
        raise ObservationError("No row shows every marker, so their common shape is unknown: measure one such row.")
    shape = _own_frame(complete[0])
    for _ in range(3):
        centred = complete - complete.mean(axis=1, keepdims=True)
        turned = np.stack([row @ nearest_rotation(row.T @ shape) for row in centred])
        shape = _own_frame(turned.mean(axis=0))
    return shape


def fit_poses(shape: Floats, markers: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Least-squares pose of the shape in every row (Kabsch 1976).

    Returns positions (N, 3) m of the shape's origin, rotations (N, 3, 3), and which rows show the three markers needed.
    """
    rows = len(markers)
    position, rotation = np.full((rows, 3), np.nan), np.tile(np.eye(3), (rows, 1, 1))
    seen = np.asarray(~np.isnan(markers).any(axis=2))
    usable = seen.sum(axis=1) >= 3
    for k in np.flatnonzero(usable):
        body, world = shape[seen[k]], markers[k, seen[k]]
        b, w = body.mean(axis=0), world.mean(axis=0)
        rotation[k] = nearest_rotation((world - w).T @ (body - b))
        position[k] = w - rotation[k] @ b
    return position, rotation, usable


def _own_frame(points: Floats) -> Floats:
    centred = points - points.mean(axis=0)
    normal = np.cross(centred[1] - centred[0], centred[2] - centred[0])
    size = np.linalg.norm(normal)
    if size < 1e-6 * np.linalg.norm(centred) ** 2 or not np.isfinite(size):
        raise ObservationError("The markers lie in one line: their turn about it cannot be seen. Add one off the line.")
    z = normal / size
    # From the middle of the first three, so that x lies in their plane wherever the others pull the origin.
    x = points[0] - points[:3].mean(axis=0)
    x = x / np.linalg.norm(x)
    return np.asarray(centred @ np.stack([x, np.cross(z, x), z], axis=1))
