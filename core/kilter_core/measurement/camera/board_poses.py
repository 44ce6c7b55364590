"""The pose of a board in each picture: from several starts, each refined until the corners fit best.

A homography, or a direct linear transform of corners in space, starts near the pose under strong perspective. From afar
noise decides what they say of perspective; weak perspective has two starts, mirrored in depth (Collins and Bartoli,
Infinitesimal plane-based pose estimation, 2014, at the middle of the board).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from kilter_core.measurement.camera.camera_model import project_held, undistort_pixels
from kilter_core.measurement.camera.views import cross
from kilter_core.observations.rig import Board, Camera
from kilter_core.transforms import nearest_rotation, rotation_exp
from kilter_core.types import Bools, Floats

STEPS = 12
RESTING = 1e-9  # m and rad: a last step, after which rounding decides what gains
Lens = tuple[str, Floats]
Found = tuple[Floats, Floats, Floats, Bools]
# An identification asks for the poses of the same views up to seven times: its checks, its start, its report.
MOST_KEPT, MOST_BYTES = 16, 1 << 20
PLANAR = 1e-6  # share of the largest spread below which corners lie in a plane
FEWEST_IN_SPACE = 6


def board_poses(camera: Camera, intrinsics: Floats, board: Board, pixels: Floats) -> Found:
    """Poses of a board before a camera: position (N, 3), rotation (N, 3, 3), rms (N,) px, and which views (N,) tell
    one. ``pixels (N, m, 2)`` are NaN where a corner was not seen. What is returned cannot be written to.
    """
    lens, corners, seen = (
        np.ascontiguousarray(given, dtype=np.float64) for given in (intrinsics, board.corners, pixels)
    )
    if seen.nbytes > MOST_BYTES:
        return _solve_poses(camera.model, lens, corners, seen)
    return _cached_poses(camera.model, lens.tobytes(), corners.tobytes(), seen.shape, seen.tobytes())


@lru_cache(maxsize=MOST_KEPT)
def _cached_poses(model: str, intrinsics: bytes, corners: bytes, shape: tuple[int, ...], pixels: bytes) -> Found:
    """As :func:`_solve_poses`, of the same numbers once."""
    lens, places, seen = (np.frombuffer(given) for given in (intrinsics, corners, pixels))
    found = _solve_poses(model, lens, places.reshape(-1, 3), seen.reshape(shape))
    for one in found:
        one.flags.writeable = False
    return found


def _solve_poses(model: str, intrinsics: Floats, corners: Floats, pixels: Floats) -> Found:
    centre, frame, flat = _fit_plane(corners)
    local = (corners - centre) @ frame
    seen: Bools = np.asarray(~np.isnan(pixels).any(axis=2))
    usable = seen.sum(axis=1) >= (4 if flat else FEWEST_IN_SPACE)
    if not usable.all():
        return _of_usable(model, intrinsics, corners, pixels, usable)
    flats = np.where(seen[..., None], undistort_pixels(model, intrinsics, pixels), 0.0)
    lens = model, intrinsics
    p, R, rms = _refine_poses(lens, local, *(_by_homography if flat else _in_space)(local, flats, seen), pixels)
    starts = [(p, _other_side(p, R))] if flat else []
    for start in (*starts, *_from_afar(local, flats, seen)):
        p, R, rms = _better((p, R, rms), _refine_poses(lens, local, *start, pixels))
    R_board = R @ frame.T
    return p - R_board @ centre, R_board, rms, np.asarray(np.isfinite(rms) & (p[:, 2] > 0.0))


def _of_usable(model: str, intrinsics: Floats, corners: Floats, pixels: Floats, usable: Bools) -> Found:
    """Poses of the views with enough corners; of the others NaN."""
    n = len(pixels)
    p, R, rms, told = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan), np.full(n, np.nan), np.zeros(n, dtype=bool)
    if usable.any():
        p[usable], R[usable], rms[usable], told[usable] = _solve_poses(model, intrinsics, corners, pixels[usable])
    return p, R, rms, told


def _fit_plane(corners: Floats) -> tuple[Floats, Floats, bool]:
    """Centre (3,), axes (3, 3) of the corners, the last across them, and whether they lie in a plane."""
    centre = corners.mean(axis=0)
    _, s, Vt = np.linalg.svd(corners - centre, full_matrices=False)
    return centre, Vt.T * np.array([1.0, 1.0, np.linalg.det(Vt)]), bool(s[2] <= PLANAR * s[0])


def _by_homography(local: Floats, flats: Floats, seen: Bools) -> tuple[Floats, Floats]:
    size = float(np.abs(local).max())
    board = np.column_stack([local[:, :2] / size, np.ones(len(local))])
    A = np.zeros((*seen.shape, 2, 9))
    A[..., 0, :3] = A[..., 1, 3:6] = board
    A[..., 0, 6:] = -flats[..., 0, None] * board
    A[..., 1, 6:] = -flats[..., 1, None] * board
    A *= seen[..., None, None]
    H = _smallest(A).reshape(-1, 3, 3) / np.array([size, size, 1.0])
    return _pose_from_columns(H[:, :, 0], H[:, :, 1], H[:, :, 2])


def _pose_from_columns(first: Floats, second: Floats, place: Floats) -> tuple[Floats, Floats]:
    scale = (
        0.5 * (np.linalg.norm(first, axis=1) + np.linalg.norm(second, axis=1)) * np.where(place[:, 2] < 0.0, -1.0, 1.0)
    )
    a, b, p = (v / scale[:, None] for v in (first, second, place))
    return p, nearest_rotation(np.stack([a, b, np.cross(a, b)], axis=-1))


def _in_space(local: Floats, flats: Floats, seen: Bools) -> tuple[Floats, Floats]:
    size = float(np.abs(local).max())
    body = np.column_stack([local / size, np.ones(len(local))])
    A = np.zeros((*seen.shape, 2, 12))
    A[..., 0, :4] = A[..., 1, 4:8] = body
    A[..., 0, 8:] = -flats[..., 0, None] * body
    A[..., 1, 8:] = -flats[..., 1, None] * body
    A *= seen[..., None, None]
    P = _smallest(A).reshape(-1, 3, 4) / np.array([size, size, size, 1.0])
    P = P * np.sign(np.linalg.det(P[:, :, :3]))[:, None, None]
    scale = np.cbrt(np.linalg.det(P[:, :, :3]))[:, None, None]
    P = P / np.where(scale == 0.0, 1.0, scale)
    return P[:, :, 3], nearest_rotation(P[:, :, :3])


def _from_afar(local: Floats, flats: Floats, seen: Bools) -> Iterator[tuple[Floats, Floats]]:
    """The two poses that weak perspective tells: the board is seen in the direction of its middle, its depth is lost."""
    rays = np.concatenate([flats, np.ones((*seen.shape, 1))], axis=-1)
    middle = np.sum(rays * seen[..., None], axis=1)
    ahead = _rotation_to(middle)
    seen_ahead = rays @ ahead
    seen_ahead = seen_ahead[..., :2] / seen_ahead[..., 2:]
    board = np.column_stack([local[:, :2], np.ones(len(local))])
    weighed = board.T @ (board * seen[..., None])
    found = np.linalg.solve(
        weighed + 1e-12 * np.trace(weighed, axis1=1, axis2=2)[:, None, None] * np.eye(3),
        board.T @ (seen_ahead * seen[..., None]),
    ).transpose(0, 2, 1)
    size = np.maximum(np.linalg.norm(found[:, :, :2], ord=2, axis=(1, 2)), 1e-12)[:, None]
    across = found[:, :, :2] / size[:, None]
    place = np.concatenate([found[:, :, 2], np.ones((len(found), 1))], axis=1) / size
    depth = np.sqrt(np.maximum(1.0 - np.sum(across**2, axis=1), 0.0))
    depth[:, 1] *= np.where(np.sum(across[:, :, 0] * across[:, :, 1], axis=1) > 0.0, -1.0, 1.0)
    for sign in (1.0, -1.0):
        first, second = np.concatenate([across, sign * depth[:, None]], axis=1).transpose(2, 0, 1)
        R = nearest_rotation(np.stack([first, second, np.cross(first, second)], axis=-1))
        yield np.einsum("nij,nj->ni", ahead, place), ahead @ R


def _rotation_to(v: Floats) -> Floats:
    """The smallest rotations (N, 3, 3) that take z to vectors (N, 3) with a positive z."""
    across = np.stack([-v[:, 1], v[:, 0], np.zeros(len(v))], axis=1)
    size = np.linalg.norm(across, axis=1, keepdims=True)
    angle = np.arctan2(size[:, 0], v[:, 2])[:, None]
    return rotation_exp(across / np.maximum(size, 1e-12) * angle)


def _smallest(A: Floats) -> Floats:
    """Vectors (N, K) that A (N, M, 2, K) takes nearest to zero."""
    flat = A.reshape(len(A), -1, A.shape[-1])
    return np.asarray(np.linalg.eigh(flat.transpose(0, 2, 1) @ flat)[1][:, :, 0])


def _other_side(p: Floats, R: Floats) -> Floats:
    """The rotation that a plane may have as well: its normal mirrored at the line of sight."""
    view = p / np.linalg.norm(p, axis=1, keepdims=True)
    normal = R[:, :, 2]
    across = np.cross(normal, view)
    size = np.linalg.norm(across, axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(size[:, 0], np.sum(normal * view, axis=1))
    return np.asarray(rotation_exp(across / np.maximum(size, 1e-12) * angle[:, None]) @ R)


def _better(one: tuple[Floats, Floats, Floats], other: tuple[Floats, Floats, Floats]) -> tuple[Floats, Floats, Floats]:
    take = np.nan_to_num(other[2], nan=np.inf) < np.nan_to_num(one[2], nan=np.inf)
    p, R, rms = (np.where(take.reshape(-1, *(1,) * (a.ndim - 1)), b, a) for a, b in zip(one, other, strict=True))
    return p, R, rms


def _refine_poses(lens: Lens, local: Floats, p: Floats, R: Floats, pixels: Floats) -> tuple[Floats, Floats, Floats]:
    """Gauss-Newton steps of every view by itself, each halved while it would not gain, until it comes to rest."""
    p, R, best = p.copy(), R.copy(), np.full(len(p), np.inf)
    kept_p, kept_R, step = p.copy(), R.copy(), np.zeros((len(p), 6))
    on = np.arange(len(p))
    for _ in range(STEPS):
        rms, whole = _step(lens, local, p[on], R[on], pixels[on])
        gained = rms < best[on]
        better = on[gained]
        best[better], kept_p[better], kept_R[better] = rms[gained], p[better], R[better]
        step[on] = np.where(gained[:, None], whole, 0.5 * step[on])
        p[on] = kept_p[on] + step[on, :3]
        R[on] = rotation_exp(step[on, 3:]) @ kept_R[on]
        rests = np.abs(step[on]).max(axis=1) < RESTING
        last = on[rests & gained]
        kept_p[last], kept_R[last] = p[last], R[last]
        on = on[~rests]
        if not len(on):
            break
    return kept_p, kept_R, best


def _step(lens: Lens, local: Floats, p: Floats, R: Floats, pixels: Floats) -> tuple[Floats, Floats]:
    """How far off (n,) px the corners of each view are, and the step (n, 6) that would gain most."""
    arms = local @ R.transpose(0, 2, 1)
    seen, by_point = project_held(*lens, arms + p[:, None])
    r = pixels - seen
    A = np.concatenate([by_point, -cross(by_point, arms[:, :, None])], axis=-1)
    A[np.isnan(r)] = 0.0
    A = A.reshape(len(p), -1, 6)
    H = A.transpose(0, 2, 1) @ A
    H += 1e-9 * np.trace(H, axis1=1, axis2=2)[:, None, None] * np.eye(6) + 1e-30 * np.eye(6)
    g = A.transpose(0, 2, 1) @ np.nan_to_num(r).reshape(len(p), -1, 1)
    return np.sqrt(_mean_square(r)), np.asarray(np.linalg.solve(H, g)[:, :, 0])


def _mean_square(r: Floats) -> Floats:
    """Mean square (N,) of what is left; NaN of a view with a corner that is seen and lies behind the camera."""
    count = (~np.isnan(r)).sum(axis=(1, 2))
    return np.where(count > 0, np.nansum(r**2, axis=(1, 2)) / np.maximum(count, 1), np.nan)
