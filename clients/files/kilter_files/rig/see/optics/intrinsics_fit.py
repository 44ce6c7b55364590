"""Intrinsics from views of boards: least squares over the camera and where the board was in every view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import FileError
from kilter_files.match.rigid_body import rotations
from kilter_files.rig.board_layout import opencv
from kilter_files.rig.see.optics.camera import FREE, Camera, project_points
from kilter_files.rig.see.optics.homography import pose_from_homography

Indices = NDArray[np.int64]

FOCALS = (0.5, 0.8, 1.2, 2.0, 4.0)  # of the picture's width, where the search begins
FEWEST_VIEWS, LEAST_CORNERS = 3, 6
ROUNDS, ENOUGH = 60, 1e-9
OUTLIER = 5.0  # robust standard deviations
STEP = 1e-6
AGAIN = 8  # without the outliers of the fit before


@dataclass(frozen=True)
class Seen:
    """One view for the fit: ``mm`` (n, 3) on the board and ``pixels`` (n, 2), and their usual standard deviation."""

    picture: str
    mm: Floats
    pixels: Floats
    sigma_px: float = 0.0


@dataclass(frozen=True)
class Fit:
    """``camera`` with its standard deviations, and what it leaves; ``poses`` (views, 6) rotation vector and place, mm."""

    camera: Camera
    rms_px: float
    view_rms_px: Floats
    left_out: int
    poses: Floats
    pictures: tuple[str, ...]


@dataclass
class _State:
    intrinsics: Floats
    rotations: Floats  # (views, 3, 3)
    places: Floats  # (views, 3) mm


@dataclass(frozen=True)
class _Data:
    mm: Floats
    pixels: Floats
    view: Indices
    weights: Floats
    model: str
    views: int
    fixed: bool = False


def fit_intrinsics(seen: Sequence[Seen], size: tuple[int, int], model: str, name: str = "camera") -> Fit:
    """Fit a camera's intrinsics.

    Raises:
        FileError: fewer than three views with six corners, or views that no camera explains.

    """
    used = [view for view in seen if len(view.pixels) >= LEAST_CORNERS]
    if len(used) < FEWEST_VIEWS:
        what = f"{len(used)} views have {LEAST_CORNERS} corners or more: intrinsics need {FEWEST_VIEWS}"
        raise FileError(f"{what}, 20 are better. Take more pictures.", code="intrinsics_too_few_views")
    data = _together(used, model)
    best = _best_start(data, used, size)
    for _ in range(AGAIN):
        state, _ = _run_levenberg_marquardt(best, data, ROUNDS)
        left = np.linalg.norm(_residuals(state, data), axis=1)
        # a wrong corner pulls its whole view: what the view leaves counts too, and only the worst of it goes
        of_view = np.array([np.median(left[data.view == k]) for k in range(data.views)])[data.view]
        limit = np.maximum(OUTLIER * max(float(np.median(left)) / 1.18, 0.02), 3 * of_view)
        kept = (left < limit).astype(np.float64)
        best = state
        if (kept == data.weights).all():
            break
        data = replace(data, weights=kept)
    return _fit_with_sigmas(best, data, size, name, tuple(view.picture for view in used))


def median_view_rms(seen: Sequence[Seen], camera: Camera) -> float | None:
    """Median over the views of what known intrinsics leave, rms px; None: no view has enough corners."""
    used = [view for view in seen if len(view.pixels) >= LEAST_CORNERS]
    if not used:
        return None
    data = replace(_together(used, camera.distortion_model), fixed=True)
    intrinsics = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion])
    start = _initial_board_poses(used, intrinsics, camera.distortion_model)
    if start is None:
        return None
    state, _ = _run_levenberg_marquardt(start, data, ROUNDS)
    squares = (_residuals(state, data) ** 2).mean(axis=1)
    return float(np.median([np.sqrt(squares[data.view == k].mean()) for k in range(data.views)]))


def _together(used: Sequence[Seen], model: str) -> _Data:
    number = np.concatenate([np.full(len(view.pixels), k, dtype=np.int64) for k, view in enumerate(used)])
    mm, pixels = np.concatenate([view.mm for view in used]), np.concatenate([view.pixels for view in used])
    return _Data(mm, pixels, number, np.ones(len(mm)), model, len(used))


def _best_start(data: _Data, used: Sequence[Seen], size: tuple[int, int]) -> _State:
    """Start from several focal lengths, without a lens first."""
    found = []
    for part in FOCALS:
        plain = np.array([part * size[0]] * 2 + [(size[0] - 1) / 2, (size[1] - 1) / 2])
        start = _initial_board_poses(used, np.concatenate([plain, np.zeros(FREE[data.model])]), data.model)
        if start is not None:
            found.append(_run_levenberg_marquardt(start, data, 12))
    if not found:
        raise FileError("No focal length explains the views.", code="intrinsics_not_found")
    return min(found, key=lambda one: one[1])[0]


def _initial_board_poses(used: Sequence[Seen], intrinsics: Floats, model: str) -> _State | None:
    """Where the boards are, by the homography of each view."""
    cv2 = opencv()
    boards = []
    for view in used:
        plain = (view.pixels - intrinsics[2:4]) / intrinsics[:2]
        if model == "fisheye":
            angle = np.clip(np.linalg.norm(plain, axis=1, keepdims=True), 1e-9, 1.4)
            plain = plain / angle * np.tan(angle)
        h, _ = cv2.findHomography(view.mm[:, :2], plain, 0)
        if h is None:
            return None
        boards.append(pose_from_homography(h))
    return _State(intrinsics, *map(np.array, zip(*boards, strict=True)))


def _points(state: _State, data: _Data) -> Floats:
    """Corners (n, 3) mm in the camera's frame."""
    return np.asarray(np.einsum("nij,nj->ni", state.rotations[data.view], data.mm) + state.places[data.view])


def _residuals(state: _State, data: _Data) -> Floats:
    return data.pixels - project_points(_points(state, data), state.intrinsics, data.model)


def _apply_state_step(state: _State, intrinsics: Floats, poses: Floats) -> _State:
    """Step: ``poses`` (views, 6) are a rotation vector in the camera's frame, and mm."""
    return _State(state.intrinsics + intrinsics, rotations(poses[:, :3]) @ state.rotations, state.places + poses[:, 3:])


def _derivatives(state: _State, data: _Data) -> tuple[Floats, Floats]:
    """Of the prediction, by intrinsics (n, 2, k) and by the pose of the own view (n, 2, 6), as central differences."""
    count = len(state.intrinsics)
    steps = np.concatenate([np.maximum(np.abs(state.intrinsics[:4]), 1.0) * STEP, np.full(count - 4, STEP)])
    none, still = np.zeros(count), np.zeros((data.views, 6))
    columns = []
    for k in range(count):
        step = none.copy()
        step[k] = steps[k]
        columns.append(_difference(state, data, step, still, steps[k]))
    size = max(1.0, float(np.abs(state.places).max()))
    for k in range(6):
        pose = still.copy()
        width = STEP if k < 3 else STEP * size
        pose[:, k] = width
        columns.append(_difference(state, data, none, pose, width))
    both = np.stack(columns, axis=-1)
    return both[..., :count], both[..., count:]


def _difference(state: _State, data: _Data, intrinsics: Floats, poses: Floats, width: float) -> Floats:
    ahead, behind = (_residuals(_apply_state_step(state, sign * intrinsics, sign * poses), data) for sign in (1, -1))
    return (behind - ahead) / (2 * width)


def _run_levenberg_marquardt(state: _State, data: _Data, rounds: int) -> tuple[_State, float]:
    damping = 1e-3
    cost = _cost(state, data)
    for _ in range(rounds):
        a, b = _derivatives(state, data)
        left = _residuals(state, data)
        while damping < 1e12:
            tried = _apply_state_step(state, *_step(a, b, left, data, damping))
            new = _cost(tried, data)
            if np.isfinite(new) and new < cost:
                break
            damping *= 10
        else:
            break
        small = cost - new < ENOUGH * cost
        state, cost, damping = tried, new, max(damping / 10, 1e-12)
        if small:
            break
    return state, cost


def _cost(state: _State, data: _Data) -> float:
    points = _points(state, data)
    if (points[:, 2] <= 0).any() or state.intrinsics[:2].min() <= 0:
        return np.inf
    left = data.pixels - project_points(points, state.intrinsics, data.model)
    return float((data.weights[:, None] * left**2).sum())


def _blocks(a: Floats, b: Floats, data: _Data) -> tuple[Floats, Floats, Floats]:
    """Normal matrices: of the intrinsics (k, k), mixed (views, k, 6), of the poses (views, 6, 6)."""
    weighted = data.weights[:, None, None]
    mixed, own = np.zeros((data.views, a.shape[2], 6)), np.zeros((data.views, 6, 6))
    np.add.at(mixed, data.view, np.einsum("nik,nij->nkj", weighted * a, b))
    np.add.at(own, data.view, np.einsum("nik,nij->nkj", weighted * b, b))
    return np.einsum("nik,nij->kj", weighted * a, a), mixed, own


def _step(a: Floats, b: Floats, left: Floats, data: _Data, damping: float) -> tuple[Floats, Floats]:
    whole, mixed, own = _blocks(a, b, data)
    weighted = data.weights[:, None] * left
    by_intrinsics, by_pose = np.einsum("nik,ni->k", a, weighted), np.zeros((data.views, 6))
    np.add.at(by_pose, data.view, np.einsum("nik,ni->nk", b, weighted))
    whole = whole + damping * np.diag(np.diag(whole) + 1e-12)
    own = own + damping * np.einsum("nij,ij->nij", own, np.eye(6)) + 1e-12 * np.eye(6)
    inverse = np.linalg.inv(own)
    if data.fixed:
        return np.zeros(a.shape[2]), np.einsum("nij,nj->ni", inverse, by_pose)
    through = mixed @ inverse
    schur = whole - np.einsum("nij,nkj->ik", through, mixed)
    step = np.linalg.lstsq(schur, by_intrinsics - np.einsum("nij,nj->i", through, by_pose), rcond=None)[0]
    return step, np.einsum("nij,nj->ni", inverse, by_pose - np.einsum("nij,i->nj", mixed, step))


def _fit_with_sigmas(state: _State, data: _Data, size: tuple[int, int], name: str, pictures: tuple[str, ...]) -> Fit:
    """Standard deviations clustered by view: what is left of the corners of one view is alike."""
    a, b = _derivatives(state, data)
    left = _residuals(state, data)
    whole, mixed, own = _blocks(a, b, data)
    through = mixed @ np.linalg.pinv(own, hermitian=True)
    inverse = np.linalg.pinv(whole - np.einsum("nij,nkj->ik", through, mixed), hermitian=True)
    reduced = a - np.einsum("nkj,nij->nik", through[data.view], b)
    scores = np.zeros((data.views, a.shape[2]))
    np.add.at(scores, data.view, np.einsum("nik,ni->nk", reduced, data.weights[:, None] * left))
    grown = data.views / max(1.0, data.views - len(state.intrinsics) / 2)
    sigmas = np.sqrt(np.maximum(np.diag(inverse @ (scores.T @ scores) @ inverse) * grown, 1e-18))
    used = data.weights > 0
    squares = (left**2).mean(axis=1)
    by_view = np.array([np.sqrt(squares[used & (data.view == k)].mean()) for k in range(data.views)])
    values = [float(value) for value in state.intrinsics]
    fx, fy, cx, cy = values[:4]
    known = tuple(float(sigma) for sigma in sigmas)
    camera = Camera(size[0], size[1], fx, fy, cx, cy, data.model, tuple(values[4:]), name, known)
    freedom = max(1, 2 * int(used.sum()) - len(values) - 6 * data.views)
    rms = float(np.sqrt((left[used] ** 2).sum() / freedom))
    vectors = np.array([_vector(rotation) for rotation in state.rotations])
    return Fit(camera, rms, by_view, int((~used).sum()), np.concatenate([vectors, state.places], axis=1), pictures)


def _vector(rotation: Floats) -> Floats:
    cv2 = opencv()
    return np.asarray(cv2.Rodrigues(rotation)[0], dtype=np.float64).ravel()
