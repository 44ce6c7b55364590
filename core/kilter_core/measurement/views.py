"""What cameras see of boards: pixels of all corners, and how they follow the tool and the unknowns of the rig."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kilter_core.measurement.camera_model import project
from kilter_core.model.placed_rig import Place, PlacedRig
from kilter_core.transforms import skew
from kilter_core.types import Floats, Ints


def pairs_of(camera: Ints, board: Ints) -> list[tuple[int, int]]:
    """Every camera (N,) with each board (N,) that it saw; rows that no camera saw have -1."""
    return sorted({(int(c), int(b)) for c, b in zip(camera, board, strict=True) if c >= 0})


@dataclass(frozen=True)
class Views:
    """N views: which ``camera (N,)`` of the rig saw which ``board (N,)``, and the tool's ``position`` and ``rotation``."""

    camera: Ints
    board: Ints
    position: Floats
    rotation: Floats

    def only(self, rows: Ints) -> Views:
        """Some of the views."""
        return Views(self.camera[rows], self.board[rows], self.position[rows], self.rotation[rows])

    def pairs(self) -> Iterator[tuple[Ints, int, int]]:
        """Rows of each pair of a camera and a board."""
        for c, b in pairs_of(self.camera, self.board):
            yield np.flatnonzero((self.camera == c) & (self.board == b)), c, b


@dataclass(frozen=True)
class Sight:
    """Pixels (N, M, 2), NaN where a board has no such corner or it is behind the camera.

    ``by_tool (N, M, 2, 6)`` are their derivatives by a motion of the tool in the axes of the measurements, about the tool
    point; ``by_rig (N, M, 2, K)`` those by the unknowns of the rig. Both are zero where there is no pixel.
    """

    pixels: Floats
    by_tool: Floats | None
    by_rig: Floats | None


def sight(rig: PlacedRig, views: Views, corners: int, slopes: bool = False) -> Sight:
    """See all views, of boards with at most so many ``corners``; with ``slopes`` also how the pixels follow."""
    rows, unknowns = len(views.position), rig.unknowns
    pixels = np.full((rows, corners, 2), np.nan)
    by_tool = np.zeros((rows, corners, 2, 6)) if slopes else None
    by_rig = np.zeros((rows, corners, 2, len(unknowns))) if slopes else None
    for which, c, b in views.pairs():
        seen = _Pair(rig, c, b, views.position[which], views.rotation[which])
        m = len(rig.rig.boards[b].corners)
        ok = seen.pixels
        pixels[which, :m] = ok
        if by_tool is None or by_rig is None:
            continue
        by_tool[which, :m] = np.nan_to_num(seen.by_tool())
        for k, (u, _) in enumerate(unknowns):
            if u.place == (c if u.camera else b):
                by_rig[which, :m, :, k] = np.nan_to_num(seen.by(u.camera, u.what)[..., u.index])
    return Sight(pixels, by_tool, by_rig)


def by_corners(rig: PlacedRig, views: Views, moves: Floats) -> Iterator[tuple[Ints, Floats]]:
    """Rows of each pair of a camera and a board, and how their pixels (n, m, 2, K) follow moves (m, K, 3) m of the corners in
    the frame of the board.
    """
    for which, c, b in views.pairs():
        yield which, _Pair(rig, c, b, views.position[which], views.rotation[which]).by_corners(moves)


class _Pair:
    """One camera and one board in n rows: points on their way from the board into the picture."""

    def __init__(self, rig: PlacedRig, c: int, b: int, position: Floats, rotation: Floats) -> None:
        camera, board = rig.rig.cameras[c], rig.rig.boards[b]
        self.lens: Place = rig.cameras[c]
        self.sheet: Place = rig.boards[b]
        self.outside = camera.mount == "fixed"
        self.X, Y = self.lens.pose, self.sheet.pose
        self.nominal = np.array(board.corners)
        self.corners = rig.corners(b)
        self.Y = Y[:3, :3]
        on_part = self.corners @ Y[:3, :3].T + Y[:3, 3]
        if self.outside:  # the board goes with the tool
            self.arms = on_part @ rotation.transpose(0, 2, 1)
            there = self.arms + position[:, None]
            self.turn = np.broadcast_to(self.X[:3, :3].T, rotation.shape)
        else:  # the camera goes with the tool
            self.arms = on_part - position[:, None]
            there = self.arms @ rotation
            self.turn = self.X[:3, :3].T @ rotation.transpose(0, 2, 1)
        self.board_turn = self.turn @ rotation if self.outside else self.turn
        self.points = (there - self.X[:3, 3]) @ self.X[:3, :3]
        self.pixels, self.by_point, self.by_intrinsics = project(camera.model, self.lens.values, self.points)
        self.kept: dict[tuple[bool, str], Floats] = {}

    def by_tool(self) -> Floats:
        """Derivative (n, m, 2, 6) by a motion of the tool."""
        toward = self.by_point @ self.turn[:, None]
        side = 1.0 if self.outside else -1.0
        spun = -side * (toward @ skew(self.arms.reshape(-1, 3)).reshape(*self.arms.shape, 3))
        return np.concatenate([side * toward, spun], axis=-1)

    def by_corners(self, moves: Floats) -> Floats:
        """Derivative (n, m, 2, K) by moves (m, K, 3) of the corners in the frame of the board."""
        toward = self.by_point @ self.board_turn[:, None]
        return np.asarray(toward @ (moves @ self.Y.T).transpose(0, 2, 1))

    def by(self, camera: bool, what: str) -> Floats:
        """Derivative (n, m, 2, ...) by the pose, the intrinsics or the scale of a part."""
        key = camera, what
        if key not in self.kept:
            made = {"pose": self._by_camera if camera else self._by_board, "scale": self._by_scale}
            self.kept[key] = self.by_intrinsics if what == "intrinsics" else made[what]()
        return self.kept[key]

    def _by_camera(self) -> Floats:
        slid = -self.by_point @ (self.X[:3, :3].T @ self.lens.origin[:3, :3])
        spun = self.by_point @ (skew(self.points.reshape(-1, 3)).reshape(*self.points.shape, 3) @ self.lens.spin)
        return np.concatenate([slid, spun], axis=-1)

    def _by_board(self) -> Floats:
        toward = self.by_point @ self.board_turn[:, None]
        slid = toward @ self.sheet.origin[:3, :3]
        spun = -toward @ (self.Y @ skew(self.corners) @ self.sheet.spin)
        return np.concatenate([slid, spun], axis=-1)

    def _by_scale(self) -> Floats:
        toward = self.by_point @ self.board_turn[:, None]
        grown = self.nominal @ self.Y.T
        return np.asarray(toward @ grown[..., None])
