"""Where camera and board stand, by views and a model of the arm: which poses show the board, and what a model leaves of them.

By the nominal arm that is good for choosing poses, and for no more: the arm's errors stay in it, and what they are worth in
the picture is the margin.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from kilter_files.ground.arrays import Bools, Floats
from kilter_files.ground.later import np
from kilter_files.match.rigid_body import rotations
from kilter_files.rig.see.optics.camera import project_points
from kilter_files.rig.see.optics.homography import nearest_rotation, pose_from_homography

FEWEST_VIEWS, FEWEST_CORNERS = 6, 6
PASSES, FAR = 4, 4.0  # times the median, beyond which a view does not count
ROUNDS, STEP = 8, 1e-6
FAR_PX = 20.0  # of a corner, beyond which it pulls less
MOST_MARGIN = 0.15  # of the picture's shorter side: beyond, the views do not say where camera and board stand
EDGE_PX = 5.0
FLAT = 1e-6  # of a board's size
ONE_AXIS = 0.02  # share of the spread of rotations below which they are about one axis
SLACK = 1.2  # of the distances at which the board was seen


@dataclass(frozen=True)
class Sight:
    """A board and a camera: ``tool_side`` A and ``world_side`` B (4, 4) of what is on the flange and of what stands, mm.

    ``facing`` is the least cosine between line of sight and the board's normal that was seen, its sign the side that is
    printed; ``depths_mm`` the nearest and farthest corner seen; ``margin_px`` how far off the nominal arm puts a corner.
    """

    camera: Mapping[str, Any]
    corners: Floats
    tool_side: Floats
    world_side: Floats
    margin_px: float = 0.0
    facing: float = 0.0
    depths_mm: tuple[float, float] = (0.0, np.inf)

    def reprojection_residuals(self, flange: Floats, pixels: Floats) -> Floats:
        """What is left of corners (N, m, 2), px, with the flange at (N, 4, 4); NaN of those not seen."""
        before = self._before_the_camera(flange)
        points = self.corners @ np.swapaxes(before[:, :3, :3], 1, 2) + before[:, None, :3, 3]
        return np.asarray(project_points(points, _intrinsics(self.camera), _model(self.camera)) - pixels)

    def score(self, flange: Floats) -> Floats:
        """How clearly the board is seen with the flange at poses (..., 4, 4): 1 at best, below 0 where it is not whole."""
        corners = self.corners[_outline(self.corners)]
        before = self._before_the_camera(flange)
        points = corners @ np.swapaxes(before[..., :3, :3], -1, -2) + before[..., None, :3, 3]
        size = np.array([self.camera["width_px"], self.camera["height_px"]], dtype=float)
        pixels = project_points(points, _intrinsics(self.camera), _model(self.camera))
        room = np.minimum(pixels, size - 1.0 - pixels).min(axis=(-1, -2)) - self.margin_px - EDGE_PX
        least = abs(self.facing)
        faces = (np.sign(self.facing) * _facing(before) - least) / max(1.0 - least, 1e-9)
        near, far = self.depths_mm
        depths = points[..., 2]
        there = (
            (depths.min(axis=-1) > near / SLACK)
            & (depths.max(axis=-1) < far * SLACK)
            & self._is_within_lens_range(points)
        )
        return np.where(there, np.minimum(2.0 * room / size.min(), faces), -1.0)

    def _is_within_lens_range(self, points: Floats) -> Bools:
        """Whether points are so near the middle that a lens does not fold them back into the picture."""
        away = np.hypot(points[..., 0], points[..., 1]) / np.maximum(points[..., 2], 1e-9)
        diagonal = np.hypot(self.camera["width_px"], self.camera["height_px"]) / float(self.camera["fx_px"])
        return np.asarray((away < diagonal).all(axis=-1))

    def _before_the_camera(self, flange: Floats) -> Floats:
        before = np.linalg.inv(self.world_side) @ flange @ self.tool_side
        return before if self.camera["mount"] == "fixed" else np.asarray(np.linalg.inv(before), dtype=float)


@dataclass(frozen=True)
class SeenBoard:
    """What a camera saw of a board: which ``views`` (K,) of those given, their ``pixels`` (K, m, 2), and where both stand."""

    sight: Sight
    views: Sequence[int]
    pixels: Floats

    def exactly(self, flange: Floats) -> SeenBoard:
        """Camera and board where all corners together fit best, with the flange at (N, 4, 4) in all views given."""
        return SeenBoard(_refine_poses(self.sight, flange[self.views], self.pixels, np.inf), self.views, self.pixels)

    def apply_pose_step(self, step: Floats) -> SeenBoard:
        """Camera and board moved by ``step`` (12,): rotation (rad) and shift (mm) of what is on the tool, then of the other."""
        return SeenBoard(_apply_pose_step(self.sight, step), self.views, self.pixels)


def sights(views: Sequence[Mapping[str, Any]], flange: Floats, rig: Mapping[str, Any]) -> list[Sight]:
    """Cameras and boards of ``rig`` that :func:`find_seen_boards` finds."""
    return [one.sight for one in find_seen_boards(views, flange, rig)]


def find_seen_boards(views: Sequence[Mapping[str, Any]], flange: Floats, rig: Mapping[str, Any]) -> list[SeenBoard]:
    """Cameras and boards of ``rig`` where views show them, one of them on the flange; none of which the views tell too little.

    ``views`` have ``u1_px``, ``v1_px`` ..., and ``camera`` and ``board`` where there are several; ``flange`` (N, 4, 4), mm.
    """
    found = []
    for c, camera in enumerate(rig.get("cameras") or [], 1):
        for b, board in enumerate(rig.get("boards") or [], 1):
            if camera.get("mount") == board.get("mount"):
                continue
            named = {"camera": (camera.get("name"), c), "board": (board.get("name"), b)}
            own = [k for k, row in enumerate(views) if _is_view_of_pair(row, named)]
            one = _fit_seen_board(camera, board, views, own, flange)
            if one is not None:
                found.append(one)
    return found


def _is_view_of_pair(row: Mapping[str, Any], named: Mapping[str, tuple[Any, int]]) -> bool:
    """Whether a view is of this camera and this board, which rows call by name or number."""
    return all(row.get(column) in (None, "", name, number, str(number)) for column, (name, number) in named.items())


def _fit_seen_board(
    camera: Mapping[str, Any],
    board: Mapping[str, Any],
    views: Sequence[Mapping[str, Any]],
    own: Sequence[int],
    flange: Floats,
) -> SeenBoard | None:
    corners = np.array(board["corners_mm"], dtype=float)
    if corners.ndim != 2 or np.ptp(corners[:, 2]) > FLAT * np.ptp(corners):
        return None
    names = [[f"{axis}{k + 1}_px" for axis in "uv"] for k in range(len(corners))]
    pixels = np.array(
        [[[_number(row.get(name)) for name in pair] for pair in names] for row in (views[k] for k in own)]
    )
    usable = [k for k, view in enumerate(pixels) if np.isfinite(view).all(axis=1).sum() >= FEWEST_CORNERS]
    if len(usable) < FEWEST_VIEWS:
        return None
    which = [own[k] for k in usable]
    pixels, flange = pixels[usable], flange[which]
    boards = np.array([_board_pose(camera, corners, view) for view in pixels])
    sides = _hand_eye(flange, boards if camera["mount"] == "fixed" else np.linalg.inv(boards))
    if sides is None:
        return None
    sight = _sight_with_margins(_refine_poses(Sight(camera, corners, *sides), flange, pixels, FAR_PX), flange, pixels)
    return None if sight is None else SeenBoard(sight, which, pixels)


def _sight_with_margins(sight: Sight, flange: Floats, pixels: Floats) -> Sight | None:
    """With what was seen of the board, and how well the nominal arm says where; None where it does not."""
    off = np.linalg.norm(sight.reprojection_residuals(flange, pixels), axis=2)
    worst = np.where(np.isnan(off), 0.0, off).max(axis=1)
    margin = float(np.quantile(worst, 0.9))
    if not margin < MOST_MARGIN * min(sight.camera["width_px"], sight.camera["height_px"]):
        return None
    before = sight._before_the_camera(flange)
    facing, depths = _facing(before), before[:, 2, 3]
    side = 1.0 if np.median(facing) > 0.0 else -1.0
    least = side * float(np.quantile(np.maximum(side * facing, 0.0)[side * facing > 0.0], 0.1))
    return Sight(
        sight.camera,
        sight.corners,
        sight.tool_side,
        sight.world_side,
        margin,
        least,
        (float(depths.min()), float(depths.max())),
    )


def _facing(before: Floats) -> Floats:
    """Cosine between the normal of boards before a camera and the line of sight."""
    place = before[..., :3, 3]
    return np.asarray(np.sum(before[..., :3, 2] * place, axis=-1) / np.linalg.norm(place, axis=-1))


def _outline(corners: Floats) -> list[int]:
    """The corners farthest out in eight directions: where they are in the picture, all are."""
    ways = np.array([[x, y, 0.0] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0) if x or y])
    return sorted({int(k) for k in np.argmax(corners @ ways.T, axis=0)})


def _board_pose(camera: Mapping[str, Any], corners: Floats, pixels: Floats) -> Floats:
    """Pose (4, 4) of a flat board before the camera, by the homography of its corners."""
    seen = np.isfinite(pixels).all(axis=1)
    size, plain = float(np.abs(corners).max()), _undistort_pixels(camera, pixels[seen])
    flat = np.column_stack([corners[seen, :2] / size, np.ones(int(seen.sum()))])
    nil = np.zeros_like(flat)
    rows = [np.hstack([flat, nil, -plain[:, :1] * flat]), np.hstack([nil, flat, -plain[:, 1:] * flat])]
    H = np.linalg.svd(np.vstack(rows))[2][-1].reshape(3, 3) / np.array([size, size, 1.0])
    return _pose(*pose_from_homography(H))


def _undistort_pixels(camera: Mapping[str, Any], pixels: Floats) -> Floats:
    """Directions (n, 2) of pixels, the lens undone by fixed-point steps."""
    intrinsics, model = _intrinsics(camera), _model(camera)
    plain = (pixels - intrinsics[2:4]) / intrinsics[:2]
    for _ in range(20):
        through = project_points(np.column_stack([plain, np.ones(len(plain))]), intrinsics, model)
        plain = plain + (pixels - through) / intrinsics[:2]
    return np.asarray(plain)


def _hand_eye(T: Floats, M: Floats) -> tuple[Floats, Floats] | None:
    """A and B of T A = B M, all (4, 4): rotations by the Kronecker product (Shah 2013), lengths by least squares."""
    spread = np.linalg.svd((T[0, :3, :3].T @ T[:, :3, :3]).reshape(len(T), 9) - np.eye(3).ravel(), compute_uv=False)
    if spread[2] <= ONE_AXIS * spread[0]:
        return None
    used = np.ones(len(T), dtype=bool)
    for _ in range(PASSES):
        K = np.einsum("nij,nkl->ikjl", T[used, :3, :3], M[used, :3, :3]).reshape(9, 9)
        U, _, Vt = np.linalg.svd(K)
        B, A = U[:, 0].reshape(3, 3), Vt[0].reshape(3, 3)
        sign = np.sign(np.linalg.det(A))
        A, B = nearest_rotation(sign * A), nearest_rotation(sign * B)
        left = np.concatenate([T[used, :3, :3], np.broadcast_to(-np.eye(3), (int(used.sum()), 3, 3))], axis=2)
        right = M[used, :3, 3] @ B.T - T[used, :3, 3]
        t = np.linalg.lstsq(left.reshape(-1, 6), right.ravel(), rcond=None)[0]
        off = np.linalg.norm(T[:, :3, :3] @ t[:3] + T[:, :3, 3] - M[:, :3, 3] @ B.T - t[3:], axis=1)
        near = off <= FAR * np.median(off)
        if np.array_equal(near, used) or near.sum() < FEWEST_VIEWS:
            break
        used = near
    return _pose(A, t[:3]), _pose(B, t[3:])


def _refine_poses(sight: Sight, flange: Floats, pixels: Floats, far_px: float) -> Sight:
    """Both poses moved until corners fit best, by Gauss-Newton with steps that gain only; a corner farther off pulls less."""
    shown = np.isfinite(pixels)

    def weighted_residuals(one: Sight) -> Floats:
        found = one.reprojection_residuals(flange, pixels)[shown]
        return found / np.sqrt(1.0 + np.abs(found) / far_px)

    best = weighted_residuals(sight)
    for _ in range(ROUNDS):
        moves = np.eye(12) * np.tile([STEP, STEP, STEP, 1e3 * STEP, 1e3 * STEP, 1e3 * STEP], 2)
        slopes = np.column_stack(
            [(weighted_residuals(_apply_pose_step(sight, move)) - best) / move.sum() for move in moves]
        )
        step = np.linalg.lstsq(slopes, -best, rcond=None)[0]
        tried = _apply_pose_step(sight, step)
        now = weighted_residuals(tried)
        if not now @ now < best @ best:
            break
        sight, best = tried, now
    return sight


def _apply_pose_step(sight: Sight, step: Floats) -> Sight:
    A, B = (
        side @ _pose(rotations(own[None, :3])[0], own[3:])
        for side, own in ((sight.tool_side, step[:6]), (sight.world_side, step[6:]))
    )
    return Sight(sight.camera, sight.corners, A, B)


def _intrinsics(camera: Mapping[str, Any]) -> Floats:
    names = ("fx_px", "fy_px", "cx_px", "cy_px")
    lens = camera.get("distortion") or ([0.0] * 4 if _model(camera) == "fisheye" else [])
    return np.array([*(float(camera[name]) for name in names), *map(float, lens)])


def _model(camera: Mapping[str, Any]) -> str:
    return str(camera.get("distortion_model") or "none")


def _number(value: Any) -> float:
    return float("nan") if value in (None, "") else float(value)


def _pose(R: Floats, p: Floats) -> Floats:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T
