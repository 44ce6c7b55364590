"""Where camera and board stand, from nothing: AX = ZB in closed form, trimmed, and for a start only.

The closed form trusts the kinematics (rotations by the Kronecker product, Shah 2013; lengths by linear least squares), so
an arm's errors stay in them; the bundle that begins there fits pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.transforms import nearest_rotation, rotation_log
from kilter_core.types import Bools, Floats

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
