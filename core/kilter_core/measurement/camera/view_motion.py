"""Whether pictures were taken when their joints were read, and whether printed boards are flat.

A picture that is late shows the board where the arm is a moment later: what is left lies along the joints' velocity. A
camera that reads line by line (rolling shutter) shows each line a little later than the one above, which no motion of the
board as a whole explains. Both are one number of all views, with its variance by poses.

What a view leaves is freed of every motion of its board first, so errors of the arm, of joints and of places have no part in
it; then of what free intrinsics and scales explain. Corners of one pose share blur and errors of the lens, so the variance
of the three numbers is by poses (Liang and Zeger 1986).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc, stdtr

from kilter_core.measurement.camera.board_poses import PLANAR
from kilter_core.measurement.camera.pixels import Pixels
from kilter_core.measurement.camera.views import Views, by_corners, sight_and_slopes, sight_by_tool
from kilter_core.model import Calibration, Prediction
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.observations import Observations
from kilter_core.types import Bools, Floats, Ints

FEWEST_CORNERS = 9  # of a view: three numbers of a shape beside six of its pose
BENDS = 3


@dataclass(frozen=True)
class BoardShape:
    """The shape of a ``board``: ``bows (2,)`` m along its sides and ``twist`` m, each the height of its middle or corners.

    ``size`` m from the highest to the lowest corner, with its standard deviation ``sigma``; ``chance`` of as much from a flat
    board, and how much of a corner it explains (``rms_px``).
    """

    board: str
    bows: tuple[float, float]
    twist: float
    size: float
    sigma: float
    chance: float
    rms_px: float
    views: int


def board_shapes(views: Pixels, prediction: Prediction, rig: PlacedRig) -> Iterator[BoardShape]:
    """Shapes of the flat boards that enough views show."""
    seen, slopes = sight_and_slopes(rig, views.views(prediction), views.pixels.shape[1])
    w = np.broadcast_to(views.weights, views.pixels.shape) / views.metres_per_px
    left = w * (views.pixels - seen)
    told = ~np.isnan(left)
    pose = views.observations.pose_groups()
    for b, board in enumerate(rig.rig.boards):
        modes = _modes(np.array(board.corners))
        rows = np.flatnonzero((views.views(prediction).board == b) & (told.sum(axis=(1, 2)) >= 2 * FEWEST_CORNERS))
        if modes is None or len(np.unique(pose[rows])) < FEWEST_VIEWS:
            continue
        moves = _bent(rig, views.views(prediction).only(rows), b, modes, views.pixels.shape[1])
        X = np.concatenate([moves, slopes.by_unknown(rows)], axis=-1) * w[rows][..., None]
        T = slopes.by_tool[rows] * w[rows][..., None]
        yield _estimate_shape(board.name, modes, _Left.from_residuals(left[rows], told[rows], T, X), pose[rows])


@dataclass(frozen=True)
class _Left:
    """What views (n, R) leave beyond motions of their boards, and how it follows the shape and what is common (n, R, K)."""

    r: Floats
    X: Floats

    @staticmethod
    def from_residuals(left: Floats, told: Bools, by_motion: Floats, X: Floats) -> _Left:
        n = len(left)
        A, X = ((one * told[..., None]).reshape(n, -1, one.shape[-1]) for one in (by_motion, X))
        both = np.concatenate([np.nan_to_num(left).reshape(n, -1, 1), X], axis=2)
        Q = np.linalg.qr(A)[0]
        both = both - Q @ (Q.transpose(0, 2, 1) @ both)
        return _Left(both[:, :, 0], both[:, :, 1:])


def _estimate_shape(name: str, modes: Floats, left: _Left, pose: Ints) -> BoardShape:
    X, r = left.X, left.r
    size = np.sqrt(np.einsum("nri,nri->i", X, X))
    size = np.where(size > 0.0, size, 1.0)
    X = X / size
    H = np.linalg.pinv(np.einsum("nri,nrj->ij", X, X), hermitian=True)
    q = H @ np.einsum("nri,nr->i", X, r)
    score = np.einsum("nri,nr->ni", X, r - X @ q)
    groups = np.unique(pose, return_inverse=True)[1]
    by_pose = np.stack([np.bincount(groups, weights=c) for c in score.T], axis=1)
    count = len(by_pose)
    free = max(count - len(q), 1)
    V = H @ (by_pose.T @ by_pose) @ H * (count / free)
    bent, C = q[:BENDS] / size[:BENDS], V[:BENDS, :BENDS] / np.outer(size[:BENDS], size[:BENDS])
    statistic = float(bent @ np.linalg.solve(C, bent)) / BENDS
    z = modes @ bent
    apart = modes[int(z.argmax())] - modes[int(z.argmin())]
    explained = (X[:, :, :BENDS] @ (bent * size[:BENDS]))[r != 0.0]
    return BoardShape(
        name,
        (float(bent[0]), float(bent[1])),
        float(bent[2]),
        float(np.ptp(z)),
        float(np.sqrt(apart @ C @ apart)),
        float(fdtrc(BENDS, free, statistic)),
        float(np.sqrt(np.mean(explained**2))),
        count,
    )


def _modes(corners: Floats) -> Floats | None:
    """Heights (m, 3) of the corners for each number: bows along both sides and the twist; None if not in one plane.

    A bow of 1 puts the middle of the board 1 above the line through the ends of its side, a twist of 1 two opposite corners
    1 above the plane and the others below it. What a plane has of them is taken out: a board's place takes that.
    """
    local = corners - corners.mean(axis=0)
    _, s, Vt = np.linalg.svd(local, full_matrices=False)
    if s[2] > PLANAR * s[0] or s[1] <= PLANAR * s[0] or len(corners) < FEWEST_CORNERS:
        return None
    across = int(np.argmax(np.abs(Vt[2])))
    x, y = (local[:, k] / np.abs(local[:, k]).max() for k in range(3) if k != across)
    raw = np.column_stack([1.0 - x**2, 1.0 - y**2, x * y])
    plane = np.column_stack([np.ones(len(x)), x, y])
    return np.asarray(raw - plane @ np.linalg.lstsq(plane, raw, rcond=None)[0])


def _bent(rig: PlacedRig, views: Views, board: int, modes: Floats, corners: int) -> Floats:
    """How pixels (n, M, 2, 3) follow the shape."""
    points = np.array(rig.rig.boards[board].corners)
    normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
    normal = normal * np.sign(normal[np.argmax(np.abs(normal))])
    out = np.zeros((len(views.position), corners, 2, BENDS))
    for which, slopes in by_corners(rig, views, modes[:, :, None] * normal):
        out[which, : len(points)] = np.nan_to_num(slopes)
    return out


FEWEST_VIEWS = 10
SPEED_PX_S = 1.0  # of a corner, below which a view is of an arm at rest
NEIGHBOURS_S = 0.25  # between rows that tell a velocity
STEP_S = 1e-4


@dataclass(frozen=True)
class Delay:
    """A time ``s`` with its standard deviation ``sigma`` and the ``chance`` of as much without it; ``rms_px`` it explains."""

    s: float
    sigma: float
    chance: float
    rms_px: float


@dataclass(frozen=True)
class Timing:
    """How late ``pictures`` are after their joints, and over which time their lines were read (``lines``, top to bottom)."""

    pictures: Delay
    lines: Delay
    views: int


def timing(views: Pixels, calibration: Calibration) -> Timing | None:
    """Return how moving views lie in time; None of an arm at rest, or where no velocities are known."""
    rows = views.observations
    qd = velocities(rows)
    if qd is None or not np.any(qd):
        return None
    prediction = calibration.predict(rows)
    rig = views.resolve_rig(prediction)
    seen, by_tool = sight_by_tool(rig, views.views(prediction), views.pixels.shape[1])
    w = np.broadcast_to(views.weights, views.pixels.shape) / views.metres_per_px
    left = w * (views.pixels - seen)
    told = ~np.isnan(left)
    by_time = np.einsum("nmic,nc->nmi", by_tool, _twists(calibration, rows, qd)) * told
    speed = np.sqrt(np.sum(by_time**2, axis=(1, 2)) / np.maximum(told.sum(axis=(1, 2)) / 2, 1))
    some = np.flatnonzero((speed > SPEED_PX_S) & (told.sum(axis=(1, 2)) >= 2 * FEWEST_VIEWS))
    if len(some) < FEWEST_VIEWS:
        return None
    assert rows.camera is not None
    heights = np.array([c.size[1] for c in rig.rig.cameras])[rows.camera[some]]
    line = views.pixels[some][..., 1] / heights[:, None] - 0.5
    pose = rows.pose_groups()[some]
    late = (w * by_time)[some]
    by_line = np.nan_to_num(late * line[..., None])
    rest = _project_out_board_motion(by_tool[some] * w[some][..., None], told[some], np.nan_to_num(left[some]), by_line)
    whole = np.nan_to_num(left[some]).reshape(len(some), -1), late.reshape(len(some), -1)
    return Timing(_delay(*whole, pose), _delay(*rest, pose), len(some))


def velocities(rows: Observations) -> Floats | None:
    """Joint velocities (N, n) as stated, else by the rows before and after, zero where those are not near in time."""
    if rows.qd is not None or rows.t is None:
        return rows.qd
    order = np.argsort(rows.t, kind="stable")
    t, q = rows.t[order], rows.q[order]
    out = np.zeros_like(q)
    if len(t) < 3:
        return out
    span = t[2:] - t[:-2]
    near = (np.diff(t)[1:] < NEIGHBOURS_S) & (np.diff(t)[:-1] < NEIGHBOURS_S) & (span > 0.0)
    out[1:-1][near] = (q[2:] - q[:-2])[near] / span[near, None]
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    return np.asarray(out[back])


def _twists(calibration: Calibration, rows: Observations, qd: Floats) -> Floats:
    """Velocities (N, 6) of the tool, m/s and rad/s."""
    ahead, behind = (calibration.predict(replace(rows, q=rows.q + side * STEP_S * qd)) for side in (1.0, -1.0))
    turn = ahead.rotation @ behind.rotation.transpose(0, 2, 1)
    spin = 0.5 * np.stack(
        [turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], 1
    )
    return np.hstack([ahead.position - behind.position, spin]) / (2.0 * STEP_S)


def _project_out_board_motion(by_motion: Floats, told: Bools, left: Floats, slope: Floats) -> tuple[Floats, Floats]:
    """What is left (n, R), and how it follows, beyond every motion of each board."""
    n = len(left)
    Q = np.linalg.qr((by_motion * told[..., None]).reshape(n, -1, 6))[0]
    both = np.stack([left.reshape(n, -1), slope.reshape(n, -1)], axis=2)
    both = both - Q @ (Q.transpose(0, 2, 1) @ both)
    return both[:, :, 0], both[:, :, 1]


def _delay(left: Floats, slope: Floats, pose: Ints) -> Delay:
    H = float(np.sum(slope**2))
    if H <= 0.0:
        return Delay(0.0, np.inf, 1.0, 0.0)
    s = float(np.sum(slope * left)) / H
    score = np.sum(slope * (left - s * slope), axis=1)
    groups = np.unique(pose, return_inverse=True)[1]
    by_pose = np.bincount(groups, weights=score)
    free = max(len(by_pose) - 1, 1)
    sigma = float(np.sqrt(np.sum(by_pose**2) * len(by_pose) / free)) / H
    chance = 2.0 * float(stdtr(free, -abs(s) / sigma)) if sigma > 0.0 else 0.0
    return Delay(s, sigma, chance, abs(s) * float(np.sqrt(H / max(int(np.count_nonzero(slope)), 1))))
