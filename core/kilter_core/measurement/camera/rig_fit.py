"""Cameras and boards put where they fit given tool poses best: closed forms for a start, then all pixels at once.

The closed form trusts the kinematics (rotations by the Kronecker product, Shah 2013; lengths by linear least squares), so
an arm's errors stay in them; the bundle that begins there fits pixels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.measurement.camera.board_poses import FEWEST_IN_SPACE, board_poses
from kilter_core.measurement.camera.views import Slopes, ToolErrors, Views, sight_and_slopes, sight_by_tool
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.observations.rig import Rig
from kilter_core.transforms import inverse, inverses, nearest_rotation, rotation_log
from kilter_core.types import Bools, Floats, Ints

MOST_TO_START = 200  # views of each camera and board that a start is found from
STEPS = 40
ROUNDS = 4  # of finding what the arm is off by and fitting again
WIDENING = 6  # steps at most in which the width of a corner's error follows the residuals
SETTLED = 1e-8  # prior sigmas
STEADY = 1e-6  # share of that width
ROUNDING = 1e-13  # share of the loss below which what a step gains cannot be told
WRONG_SIGMAS = 3.0  # of the median residual: beyond, a corner counts as Huber has it
SMALLEST_OFF = (1e-7, 1e-7)  # m and rad that the tool of a view is off by
SMALLEST_PX = 1e-3


@dataclass(frozen=True)
class FittedRig:
    """A rig as it fits, with the covariance (K, K) of its unknowns and the standard deviation of a corner, px."""

    rig: PlacedRig
    covariance: Floats
    sigma_px: float


def estimate_start_rig(rig: Rig, views: Views, pixels: Floats) -> PlacedRig:
    """Start values: each board's pose in each view, then AX = ZB of each pair of a camera and a board, of so many views
    (``MOST_TO_START``) of each pair, spread over all of them.

    Raises:
        ObservationError: ``no_view``, or ``hand_eye_undetermined``.

    """
    cameras: dict[int, Floats] = {}
    boards: dict[int, Floats] = {}
    pairs = []
    for which, c, b in views.pairs():
        camera, board = rig.cameras[c], rig.boards[b]
        values = np.array(camera.values)
        which = thin_views(which, pixels)
        p, R, _, usable = board_poses(camera, values, board, pixels[which][:, : len(board.corners)])
        pairs.append((int(usable.sum()), c, b, which[usable], p[usable], R[usable]))
    for count, c, b, which, p, R in sorted(pairs, key=lambda pair: (-pair[0], pair[1], pair[2])):
        if c in cameras and b in boards:
            continue
        if not count:
            raise ObservationError(
                f"Camera {rig.cameras[c].name!r} saw four corners or more of board {rig.boards[b].name!r} in no view: "
                "measure some, or leave the camera out.",
                code="no_view",
            )
        found = _pair(rig, (c, b), views, which, p, R, cameras, boards)
        tool_side, world_side = found.tool_side, found.world_side
        fixed = rig.cameras[c].mount == "fixed"
        cameras.setdefault(c, world_side if fixed else tool_side)
        boards.setdefault(b, tool_side if fixed else world_side)
    return PlacedRig.at_poses(rig, cameras, boards)


def thin_views(which: Ints, pixels: Floats) -> Ints:
    """So many of the views ``which`` that a start needs, of those of ``pixels (N, M, 2)`` that show enough corners."""
    enough = which[(~np.isnan(pixels[which]).any(axis=2)).sum(axis=1) >= FEWEST_IN_SPACE]
    some = enough if len(enough) else which
    return some[:: max(1, -(-len(some) // MOST_TO_START))]


def _pair(
    rig: Rig,
    pair: tuple[int, int],
    views: Views,
    which: Ints,
    p: Floats,
    R: Floats,
    cameras: Mapping[int, Floats],
    boards: Mapping[int, Floats],
) -> HandEye:
    """Camera and board of a pair; where one of them stands already, the other from that."""
    c, b = pair
    fixed = rig.cameras[c].mount == "fixed"
    if not fixed:  # what the tool carries is the camera: the board's pose is seen from there
        p, R = inverses(p, R)
    T_p, T_R = views.position[which], views.rotation[which]
    if c not in cameras and b not in boards:
        return solve_axzb(T_p, T_R, p, R)
    of_tool, of_room = (boards.get(b), cameras.get(c)) if fixed else (cameras.get(c), boards.get(b))
    known_tool = of_tool is not None
    known = of_tool if of_tool is not None else of_room
    assert known is not None
    made = []
    for k in range(len(p)):
        T, M = np.eye(4), np.eye(4)
        T[:3, :3], T[:3, 3], M[:3, :3], M[:3, 3] = T_R[k], T_p[k], R[k], p[k]
        made.append(T @ known @ inverse(M) if known_tool else inverse(T) @ known @ M)
    each = np.reshape(made, (-1, 16))
    apart = np.linalg.norm(each[:, None] - each, axis=2)
    other = made[int(np.argmin(np.median(apart, axis=1)))]
    zero = np.zeros(len(p))
    return HandEye(*((known, other) if known_tool else (other, known)), zero, zero)


def fit_rig(start: PlacedRig, views: Views, pixels: Floats, sigma: Floats | None = None) -> FittedRig:
    """Fit all unknowns of the rig to pixels (N, M, 2), the tool poses held; wrong corners are bounded (Huber).

    ``sigma (N, M, 2)`` px are the corners' own standard deviations, up to one factor that the residuals tell.
    """
    rig = start.with_folded_increments()
    prior = np.array([p.prior_sigma for p in rig.parameters])
    mean = np.array([p.value for p in rig.parameters])
    weight = _weight(sigma)
    values, damping, width, corners = rig.values, 1e-6, np.inf, pixels.shape[1]
    seen, slopes = sight_and_slopes(rig.with_values(values), views, corners)
    loss = np.inf
    for step in range(STEPS):
        r, before = weight * (pixels - seen), width
        if step < WIDENING:
            width = max(_width(r), SMALLEST_PX)
            loss = _loss(r / width, (values - mean) / prior)
        H, g = _equations(slopes, r, weight, width, prior, (values - mean) / prior)
        while True:
            move = np.linalg.solve(H + damping * np.diag(np.diag(H)), g)
            # Nearly every step is good, so its derivatives are taken at once.
            there, ahead = sight_and_slopes(rig.with_values(values + move * prior), views, corners)
            new = _loss(weight * (pixels - there) / width, (values + move * prior - mean) / prior)
            if new <= loss or damping > 1e6 or float(move @ g) < ROUNDING * loss:
                break
            damping *= 10.0
        values, seen, slopes, damping = values + move * prior, there, ahead, max(0.1 * damping, 1e-9)
        loss = new
        rests = float(np.max(np.abs(move), initial=0.0)) < SETTLED or float(move @ g) < ROUNDING * loss
        # A step that damping made small says nothing while the width may still change.
        steady = step >= WIDENING or (damping < 1.0 and abs(width - before) <= STEADY * width)
        if steady and rests:
            break
    covariance = np.asarray(np.linalg.inv(H) * np.outer(prior, prior), dtype=np.float64)
    return FittedRig(rig.with_values(values).with_folded_increments(), covariance, float(width))


def fit_rig_beside_arm(start: PlacedRig, views: Views, pixels: Floats, sigma: Floats | None = None) -> FittedRig:
    """Fit the rig to views of an arm that is held and need not be right: each counts as far as views scatter.

    Pixels alone hardly care how far away a board is: with an arm that is millimetres off, cameras would stand where corners
    agree best and the tool seems to be several times as far off as it is.
    """
    found = fit_rig(start, views, pixels, sigma)
    for _ in range(ROUNDS):
        errors = tool_errors(found.rig, views, pixels, sigma)
        if errors.numbers <= 0:
            return found
        off = errors.scatter(6.0 * (len(found.rig.cameras) + len(found.rig.boards)))
        found = fit_rig_of_arm(found, views, pixels, (off.place, off.turn), off.sigma_px, sigma)
    return found


def tool_errors(rig: PlacedRig, views: Views, pixels: Floats, sigma: Floats | None = None) -> ToolErrors:
    """How far the tool of each view is from where these cameras and boards have it."""
    seen, by_tool = sight_by_tool(rig, views, pixels.shape[1])
    weight = np.broadcast_to(_weight(sigma), pixels.shape)
    return ToolErrors.from_residuals(weight * (pixels - seen), weight[..., None] * by_tool)


def _weight(sigma: Floats | None) -> float | Floats:
    """How much a pixel counts beside the others, by its own standard deviation; one that was not seen counts nothing."""
    return 1.0 if sigma is None else np.nan_to_num(np.sqrt(np.nanmean(sigma**2)) / sigma)


def fit_rig_of_arm(
    found: FittedRig,
    views: Views,
    pixels: Floats,
    off: tuple[float, float],
    sigma_px: float,
    sigma: Floats | None = None,
) -> FittedRig:
    """Fit again where the tool of each view is ``off`` by m and rad of a coordinate, and a corner by ``sigma_px``.

    ``sigma`` as in :func:`fit_rig`; ``sigma_px`` is then that of corners that are as good as all are on average.

    All corners of a view share what its tool is off by, so together they count no more than the arm is known: pixels alone
    would take a shift of the camera with a rotation that undoes it in the picture for as certain as corners are.
    """
    rig, known = found.rig, np.repeat(np.maximum(off, SMALLEST_OFF), 3) ** -2.0
    prior = np.array([p.prior_sigma for p in rig.parameters])
    mean = np.array([p.value for p in rig.parameters])
    told, values, weight = ~np.isnan(pixels), rig.values, np.broadcast_to(_weight(sigma), pixels.shape)
    for _ in range(STEPS):
        seen, slopes = sight_and_slopes(rig.with_values(values), views, pixels.shape[1])
        told = told & ~np.isnan(seen)
        span, inner = slopes.low_rank_factors()
        counts = np.where(told, weight, 0.0)
        A = (span * counts[..., None]).reshape(len(span), -1, span.shape[3])
        r = np.where(told, counts * (pixels - seen), 0.0).reshape(len(span), -1, 1)
        root = np.where(told, 1.0 / sigma_px, 0.0).reshape(r.shape)
        root *= _root((r - _project_on_tool_motion(A, r, root, known)) / sigma_px)
        B, s = root * A, root * r
        tool = B[..., :6]
        rest = np.linalg.inv(np.diag(known) + tool.transpose(0, 2, 1) @ tool) @ tool.transpose(0, 2, 1)
        inner = inner * prior
        J, s = B - tool @ (rest @ B), s - tool @ (rest @ s)
        H = np.einsum("nik,nij,njl->kl", inner, B.transpose(0, 2, 1) @ J, inner) + np.eye(len(prior))
        g = np.einsum("nik,nij->k", inner, B.transpose(0, 2, 1) @ s) - (values - mean) / prior
        move = np.linalg.solve(H, g)
        values = values + move * prior
        if float(np.max(np.abs(move), initial=0.0)) < SETTLED:
            break
    covariance = np.asarray(np.linalg.inv(H) * np.outer(prior, prior), dtype=np.float64)
    return FittedRig(rig.with_values(values).with_folded_increments(), covariance, sigma_px)


def _project_on_tool_motion(A: Floats, r: Floats, root: Floats, known: Floats) -> Floats:
    """What of residuals (N, R, 1) px a motion of the tool explains, whose six numbers are ``known (6,)`` that well."""
    tool, weighed = A[..., :6], (root**2 * A[..., :6]).transpose(0, 2, 1)
    return np.asarray(tool @ np.linalg.solve(np.diag(known) + weighed @ tool, weighed @ r))


def _equations(
    seen: Slopes, r: Floats, weight: float | Floats, width: float, prior: Floats, away: Floats
) -> tuple[Floats, Floats]:
    told, root = ~np.isnan(r), _root(r / width) / width
    n, size = len(r), r[0].size
    span, inner = seen.low_rank_factors()
    A = (span * np.where(told, root * weight, 0.0)[..., None]).reshape(n, size, -1)
    inner = inner * prior
    scaled = np.where(told, r * root, 0.0).reshape(n, size, 1)
    A_T = A.transpose(0, 2, 1)
    flat = inner.reshape(-1, len(prior))
    H = flat.T @ ((A_T @ A) @ inner).reshape(-1, len(prior))
    return H + np.eye(len(prior)), flat.T @ (A_T @ scaled).reshape(-1) - away


def _root(s: Floats) -> Floats:
    """Root of Huber's weight of whitened numbers."""
    return np.asarray(np.sqrt(WRONG_SIGMAS / np.maximum(np.abs(np.nan_to_num(s)), WRONG_SIGMAS)))


def _loss(s: Floats, away: Floats) -> float:
    size = np.abs(s[~np.isnan(s)])
    bounded = np.where(size <= WRONG_SIGMAS, 0.5 * size**2, WRONG_SIGMAS * (size - 0.5 * WRONG_SIGMAS))
    return float(bounded.sum() + 0.5 * away @ away)


def _width(r: Floats) -> float:
    left = np.abs(r[~np.isnan(r)])
    return float(np.median(left)) / 0.6745 if len(left) else 1.0


FEWEST_VIEWS = 3
PASSES = 4
FAR = 4.0  # times the median, beyond which a view does not count for the start
HIDDEN = 1e-12  # share (squared) of the lengths of an arm that moves about one point, up to rounding
SAME_AXIS = 0.02  # share of the rotations' spread below which all rotate about one axis


@dataclass(frozen=True)
class HandEye:
    """``tool_side`` A and ``world_side`` B (4, 4) with T A = B M in every view; what is left (N,) m and rad."""

    tool_side: Floats
    world_side: Floats
    left_m: Floats
    left_rad: Floats


def solve_axzb(T_p: Floats, T_R: Floats, M_p: Floats, M_R: Floats) -> HandEye:
    """A and B of T A = B M, from poses of the tool ``T`` and of what the camera measured ``M``, (N, 3) and (N, 3, 3).

    Raises:
        ObservationError: too few views, or rotations about one axis only.

    """
    if len(T_p) < FEWEST_VIEWS:
        raise ObservationError(
            f"{len(T_p)} views tell no camera from its board: {FEWEST_VIEWS} or more are needed, and 15 for a good start.",
            code="hand_eye_undetermined",
        )
    _refuse_one_axis(T_R)
    used = np.ones(len(T_p), dtype=bool)
    for _ in range(PASSES):
        found = _solve_closed_form(T_p, T_R, M_p, M_R, used)
        far = _outlier_mask(found.left_m) | _outlier_mask(found.left_rad)
        if np.array_equal(~far, used) or (~far).sum() < max(FEWEST_VIEWS, len(T_p) // 2):
            break
        used = ~far
    return found


def _refuse_one_axis(R: Floats) -> None:
    turns = rotation_log(R[0].T @ R)
    spread = np.linalg.svd(turns, compute_uv=False)
    if spread[1] <= SAME_AXIS * spread[0] or spread[0] < 1e-3:
        raise ObservationError(
            "The tool was rotated about one axis only: where the camera stands along that axis cannot be told from where the "
            "board is. Add views rotated by 20 degrees or more about another axis.",
            code="hand_eye_undetermined",
        )


def _outlier_mask(left: Floats) -> Bools:
    return np.asarray(left > FAR * max(float(np.median(left)), 1e-9))


def _solve_closed_form(T_p: Floats, T_R: Floats, M_p: Floats, M_R: Floats, used: Bools) -> HandEye:
    K = np.einsum("nij,nkl->ikjl", T_R[used], M_R[used]).reshape(9, 9)
    U, _, Vt = np.linalg.svd(K)
    B, A = U[:, 0].reshape(3, 3), Vt[0].reshape(3, 3)
    sign = 1.0 if np.linalg.det(A) > 0.0 else -1.0
    A, B = nearest_rotation(sign * A), nearest_rotation(sign * B)
    n = int(used.sum())
    left = np.concatenate([T_R[used], np.broadcast_to(-np.eye(3), (n, 3, 3))], axis=2).reshape(-1, 6)
    right = (M_p[used] @ B.T - T_p[used]).reshape(-1)
    t = np.linalg.lstsq(left, right, rcond=None)[0]
    off = T_p + T_R @ t[:3] - M_p @ B.T - t[3:]
    turned = rotation_log(np.swapaxes(T_R @ A, 1, 2) @ (B @ M_R))
    return HandEye(_pose(A, t[:3]), _pose(B, t[3:]), np.linalg.norm(off, axis=1), np.linalg.norm(turned, axis=1))


def grown(T_p: Floats, T_R: Floats, M_p: Floats, found: HandEye) -> tuple[float, float, float]:
    """By what factor all lengths that the camera measured grow in T A = B M, its standard deviation, and what is left then (m,
    median), of the views that are not far off.

    The camera's lengths have the noise, so they are what is explained; the deviation is infinite where the poses move the
    arm only about one point, for then nothing of its lengths is seen.
    """
    used, n = ~_outlier_mask(found.left_m), len(T_p)
    seen = M_p @ found.world_side[:3, :3].T
    placed = np.concatenate([T_R, np.broadcast_to(-np.eye(3), (n, 3, 3))], axis=2)
    A, lengths, right = placed[used].reshape(-1, 6), T_p[used].reshape(-1), seen[used].reshape(-1)
    own = lengths - A @ np.linalg.lstsq(A, lengths, rcond=None)[0]
    if own @ own < HIDDEN * (lengths @ lengths):
        return 1.0, float("inf"), float(np.median(found.left_m))
    shrunk = float(own @ right / (own @ own))  # of the arm's lengths to the camera's
    x = np.linalg.lstsq(A, right - shrunk * lengths, rcond=None)[0]
    off = seen - shrunk * T_p - placed @ x
    variance = float(np.sum(off[used] ** 2)) / max(len(right) - 7, 1)
    by = 1.0 / shrunk if shrunk else float("inf")
    return by, float(np.sqrt(variance / (own @ own))) * by**2, float(np.median(np.linalg.norm(off, axis=1))) * abs(by)


def _pose(R: Floats, p: Floats) -> Floats:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T
