"""Where a flat board is, by the homography of its corners."""

from __future__ import annotations

from kilter_files.ground.arrays import Floats
from kilter_files.ground.later import np


def pose_from_homography(homography: Floats) -> tuple[Floats, Floats]:
    """Return rotation (3, 3) and place (3,), in the board's unit, of a board whose plane a homography (3, 3) sees so."""
    h = homography * (1 if homography[2, 2] > 0 else -1) / np.linalg.norm(homography[:, :2], axis=0).mean()
    return nearest_rotation(np.column_stack([h[:, 0], h[:, 1], np.cross(h[:, 0], h[:, 1])])), h[:, 2]


def nearest_rotation(M: Floats) -> Floats:
    """Return the rotation (3, 3) nearest to a matrix."""
    u, _, vt = np.linalg.svd(M)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)
