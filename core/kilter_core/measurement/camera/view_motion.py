"""Whether pictures were taken when their joints were read, and all lines of them at once: by what moving views leave.

A picture that is late shows the board where the arm is a moment later: what is left lies along the joints' velocity. A
camera that reads line by line (rolling shutter) shows each line a little later than the one above, which no motion of the
board as a whole explains. Both are one number of all views, with its variance by poses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtr

from kilter_core.measurement.camera.pixels import Pixels
from kilter_core.measurement.camera.views import sight_by_tool
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.types import Bools, Floats, Ints

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
