"""At which poses a camera sees a board well: whole, inside the picture, and facing the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.measurement.camera.camera_model import project, undistort_pixels
from kilter_core.model import Prediction
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.transforms import inverse, inverses
from kilter_core.types import Bools, Floats

RIM = 0.02  # share of the picture left free at its edges
SLANTED = 0.5  # cosine between normal and line of sight below which corners blur into each other
FLAT = 1e-3  # of its size that a board may be thick
OUTWARD = 0.75  # the same of a corner of a solid and of the way to it from the middle: its surface is not known
FEWEST_CORNERS = 4
BACK = 1e-6  # how well a lens must lead back to the direction: far outside the picture it folds


@dataclass(frozen=True)
class Pair:
    """Camera ``c`` of a rig and board ``b``. ``side`` is 1 where the board's z points away from who reads it, else -1."""

    rig: PlacedRig
    c: int
    b: int
    side: float = 1.0

    @property
    def corners(self) -> Floats:
        """Corners (M, 3) m in the board's frame."""
        return self.rig.corners(self.b)

    def poses(self, tool: Prediction) -> tuple[Floats, Floats]:
        """Board in the camera's frame, (N, 3) m and (N, 3, 3)."""
        p, R = tool.position, tool.rotation
        if self.rig.rig.cameras[self.c].mount == "flange":
            p, R = inverses(p, R)
        X, Y = inverse(self.rig.cameras[self.c].pose), self.rig.boards[self.b].pose
        return (p + R @ Y[:3, 3]) @ X[:3, :3].T + X[:3, 3], X[:3, :3] @ R @ Y[:3, :3]

    def pixels(self, tool: Prediction) -> Floats:
        """Corners (N, M, 2) px; NaN those out of sight, and all where the board is not seen well."""
        p, R = self.poses(tool)
        out = np.full((len(p), len(self.corners), 2), np.nan)
        turned = self._facing_corners(p, R)
        some = np.flatnonzero(turned.sum(axis=1) >= min(FEWEST_CORNERS, len(self.corners)))
        points = self.corners @ R[some].transpose(0, 2, 1) + p[some, None]
        camera = self.rig.rig.cameras[self.c]
        near = (points[..., 2] > 0.0).all(axis=1)
        if camera.model != "fisheye":  # a lens bends less than by half
            wide = 1.5 * np.array(camera.size) / np.array(camera.focal)
            near &= (np.abs(points[..., :2]) <= wide * points[..., 2:]).all(axis=(1, 2))
        some, points = some[near], points[near]
        values = self.rig.cameras[self.c].values
        seen = project(camera.model, values, points).pixels
        rim = RIM * np.array(camera.size)
        inside = ((seen >= rim) & (seen <= np.array(camera.size) - 1 - rim)).all(axis=2)
        ok = (inside | ~turned[some]).all(axis=1)
        some, points, seen = some[ok], points[ok], seen[ok]
        back = undistort_pixels(camera.model, values, seen) - points[..., :2] / points[..., 2:]
        own = turned[some]
        good = (np.isfinite(back).all(axis=2) & (np.abs(back) < BACK).all(axis=2) | ~own).all(axis=1)
        out[some[good]] = np.where(own[good][..., None], seen[good], np.nan)
        return out

    def _facing_corners(self, p: Floats, R: Floats) -> Bools:
        """Corners (N, M) whose surface looks at the camera; of a solid those on the side towards it."""
        corners = self.corners
        middle = corners.mean(axis=0)
        _, s, axes = np.linalg.svd(corners - middle, full_matrices=False)
        towards = -(R @ middle + p)
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        if s[2] < FLAT * s[0]:
            normal = axes[2] if axes[2, 2] < 0.0 else -axes[2]
            facing = self.side * np.sum((R @ normal) * towards, axis=1) >= SLANTED
            return np.repeat(facing[:, None], len(corners), axis=1)
        outward = corners - middle
        outward = outward / np.linalg.norm(outward, axis=1, keepdims=True)
        return np.asarray(np.einsum("nij,mj,ni->nm", R, outward, towards) >= OUTWARD)


def pairs(rig: PlacedRig, driven: Prediction | None = None) -> tuple[Pair, ...]:
    """Every camera with the boards that move against it; which side of a board is printed, poses ``driven`` before tell."""
    found = [
        Pair(rig, c, b)
        for c, camera in enumerate(rig.rig.cameras)
        for b, board in enumerate(rig.rig.boards)
        if camera.mount != board.mount
    ]
    return tuple(one if driven is None else _choose_printed_side(one, driven) for one in found)


def _choose_printed_side(pair: Pair, driven: Prediction) -> Pair:
    sides = [Pair(pair.rig, pair.c, pair.b, side) for side in (1.0, -1.0)]
    front, back = (int((~np.isnan(one.pixels(driven)[..., 0])).any(axis=1).sum()) for one in sides)
    return sides[0] if front >= back else sides[1]
