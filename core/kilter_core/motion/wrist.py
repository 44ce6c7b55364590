"""A force sensor at the wrist: its bias, how it is mounted, what hangs on it, and what else it feels.

The wrench that it reads is its bias less what moves the body behind it (Atkeson, An and Hollerbach 1986); gravity from three
directions shows the sensor's axes, too. A second of a log, or a pose at rest, is one observation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from kilter_core.arm.robot import Robot
from kilter_core.errors import ObservationError
from kilter_core.motion.normal import BLOCK_S
from kilter_core.motion.payload import CarriedBody, describe_carried
from kilter_core.motion.record import Log, Part
from kilter_core.motion.regressor import PER_LINK, flange_in_link, tool_wrench_regressor
from kilter_core.observations import Observations
from kilter_core.transforms import nearest_rotation, rotation_exp, rotation_log, skew
from kilter_core.types import QUANTILE, Bools, Floats, Ints

LOG_STEP_S = 0.1  # rows that come slower are poses at rest, whatever their times
FIRST = 4  # numbers of a body that gravity shows
FEWEST_POSES = 6
ROTATED = 0.15  # of gravity, by which it must rotate (rms) in two directions, and in a third for the axes of the sensor
STEPS = 12
TOUCHED = 30.0  # times the usual square of a row, from which something else touched the tool
MOST_TOUCHED = 0.3  # of the rows
UNEXPLAINED = 0.33  # of the spread of the force
GYRATION_M = 0.1  # of the mass found: an inertia that is less well known than this makes it does not show


@dataclass(frozen=True)
class WristReading:
    """``body`` hangs behind the sensor, in the tool frame; its inertia is NaN where the motion does not show it.

    ``bias (6,)`` N and N m, and ``mounting (3,)`` rad the rotation vector from the flange's axes to the sensor's, each with
    standard deviations; those of the mounting are NaN where gravity did not rotate far enough to tell, so that it was believed.
    ``free (N, 6)`` is the wrench without bias, gravity and inertia in the rows at ``at (N,)``: seconds of a log that is
    ``moving``, else numbers of the rows.
    ``touched (N,)`` are rows left out because something else touched the tool, ``left (6,)`` what the others leave, rms.
    """

    body: CarriedBody
    bias: Floats
    bias_sigma: Floats
    mounting: Floats
    mounting_sigma: Floats
    at: Floats
    free: Floats
    touched: Bools
    left: Floats
    moving: bool


@dataclass(frozen=True)
class _Rows:
    """What is compared: wrenches ``w (N, 6)``, matrices ``Y (N, 6, 10)`` of the body, and the ``block (N,)`` of each row."""

    at: Floats
    w: Floats
    Y: Floats
    block: Ints

    def select(self, kept: Bools) -> _Rows:
        return _Rows(self.at[kept], self.w[kept], self.Y[kept], self.block[kept])


@dataclass(frozen=True)
class _Solved:
    """``x (k,)``: bias, the first numbers of the body, a rotation of the sensor where it is free; ``R`` maps its axes to the
    flange's.
    """

    x: Floats
    R: Floats
    weights: Floats
    residuals: Floats
    J: Floats
    numbers: int

    @property
    def force_left(self) -> float:
        """What is left of the force, rms of its components, N."""
        return float(np.sqrt(np.mean(self.residuals[:, :3] ** 2)))

    @property
    def shows_inertia(self) -> bool:
        """Whether an inertia was fitted and is better known than a guess by the mass."""
        spread = np.linalg.pinv(np.einsum("nia,i,nib->ab", self.J, self.weights, self.J))
        return bool(np.sqrt(np.diag(spread)[6 + FIRST : 6 + PER_LINK].max()) < abs(self.x[6]) * GYRATION_M**2)


def read_wrist(robot: Robot, observations: Observations, sensor: Floats | None = None) -> WristReading:
    """Return what a sensor with its origin at ``sensor (3,)`` m of the flange says in poses at rest, or in a log with ``t``.

    Raises:
        ObservationError: ``wrench_missing``, ``wrench_poses`` where gravity does not rotate, ``wrench_sign`` where
            the readings are of the other sign, ``wrench_unexplained`` where they do not follow gravity.

    """
    flange = flange_in_link(robot)
    place = flange.copy()
    place[:3, 3] += place[:3, :3] @ (np.zeros(3) if sensor is None else sensor)
    rows, moving = _collect_rows(robot, observations, place)
    free = _refuse_few_directions(rows)
    touched = _find_touched(rows, free)
    kept = rows.select(~touched)
    fit = _solve(kept, FIRST, free)
    _refuse_wrong_readings(kept, fit, free)
    if moving and (whole := _solve(kept, PER_LINK, free)).shows_inertia:
        fit = whole
    spread = _jackknife(kept, fit)
    sigma = np.sqrt(np.diag(spread))
    return WristReading(
        _describe_body(fit, spread, np.linalg.inv(place) @ flange @ robot.T_tool),
        fit.x[:6],
        sigma[:6],
        rotation_log(fit.R),
        sigma[6 + fit.numbers :] if free else np.full(3, np.nan),
        rows.at,
        rows.w - _predict(rows, fit),
        touched,
        np.sqrt(np.mean(fit.residuals**2, axis=0)),
        moving,
    )


def _find_touched(rows: _Rows, free: bool) -> Bools:
    """Rows (N,) that are far beyond the others, unless they are many: then it is the model that is wrong."""
    touched = np.zeros(len(rows.w), dtype=bool)
    for _ in range(STEPS):
        squares = (rows.w - _predict(rows, _solve(rows.select(~touched), FIRST, free))) ** 2
        left = np.sum(squares / np.median(squares, axis=0), axis=1)
        far = left > TOUCHED * np.median(left)
        if far.mean() > MOST_TOUCHED or np.array_equal(far, touched):
            break
        touched = far
    return touched


def _describe_body(fit: _Solved, spread: Floats, tool: Floats) -> CarriedBody:
    """The body in the tool frame, which is at ``tool (4, 4)`` of the sensor's place; without inertia where none was fitted."""
    own, at = slice(0, fit.numbers), slice(6, 6 + fit.numbers)
    numbers, across = np.zeros(PER_LINK), np.zeros((PER_LINK, PER_LINK))
    numbers[own], across[own, own] = fit.x[at], spread[at, at]
    body = describe_carried(tool, numbers, across, np.zeros((2, 0)))
    unknown = np.full((3, 3), np.nan)
    return body if fit.numbers == PER_LINK else replace(body, inertia=unknown, inertia_sigma=unknown)


def _collect_rows(robot: Robot, observations: Observations, place: Floats) -> tuple[_Rows, bool]:
    """Rows of a log, filtered alike, or of poses at rest; and whether it is a log."""
    wrench, t, q = observations.wrench, observations.t, observations.q
    if wrench is None or not np.ptp(wrench, axis=0).all():
        raise ObservationError(
            "These rows have no readings of a force sensor, or the same in all rows: upload fx_n, fy_n, fz_n, mx_nm, my_nm and "
            "mz_nm as it read them in each.",
            code="wrench_missing",
        )
    steps = np.zeros(0) if t is None else np.diff(t)
    if not len(steps) or np.median(steps[steps > 0.0]) > LOG_STEP_S:
        rest = np.zeros_like(q)
        Y = tool_wrench_regressor(robot, q, rest, rest, place)
        count = np.arange(len(q))
        return _Rows(count.astype(np.float64) + 1.0, wrench, Y, count), False
    log = Log.from_observations(replace(observations, tau=wrench))
    return _join([_smooth_rows(robot, part, place) for part in log.parts()]), True


def _smooth_rows(robot: Robot, part: Part, place: Floats) -> _Rows:
    Y = part.smooth(tool_wrench_regressor(robot, part.q, part.qd, part.qdd, place))
    t = part.t[part.rows]
    rows = _Rows(t, part.smooth(part.tau), Y, ((t - part.t[0]) / BLOCK_S).astype(np.int64))
    return rows.select(np.asarray(np.all(part.usable[part.rows], axis=1)))


def _join(parts: list[_Rows]) -> _Rows:
    firsts = np.cumsum([0, *(one.block.max(initial=0) + 1 for one in parts)])
    return _Rows(
        np.concatenate([one.at for one in parts]),
        np.concatenate([one.w for one in parts]),
        np.concatenate([one.Y for one in parts]),
        np.concatenate([one.block + first for one, first in zip(parts, firsts.tolist(), strict=False)]),
    )


def _refuse_few_directions(rows: _Rows) -> bool:
    """Refuse rows in which gravity does not rotate; return whether it rotated so far that it shows the sensor's axes."""
    pulls = rows.Y[:, :3, 0]
    squares = np.linalg.eigvalsh(np.cov(pulls.T)) / np.mean(np.sum(pulls**2, axis=1))
    if len(np.unique(rows.block)) < FEWEST_POSES or squares[1] < ROTATED**2:
        raise ObservationError(
            f"A bias and a mass are told apart by gravity from three directions: record {FEWEST_POSES} poses or more, or a "
            "motion, with the wrist rotated about two axes by 60 degrees and more.",
            code="wrench_poses",
        )
    return bool(squares[0] > ROTATED**2)


def _solve(rows: _Rows, numbers: int, free: bool) -> _Solved:
    """Gauss-Newton from closed forms, each component weighed by what it leaves."""
    X = np.column_stack([np.ones(len(rows.w)), rows.Y[:, :3, 0]])
    found = np.asarray(np.linalg.lstsq(X, rows.w[:, :3], rcond=None)[0], dtype=np.float64)
    R = nearest_rotation(-found[1:]) if free else np.eye(3)
    x = np.zeros(6 + numbers + 3 * free)
    weights = np.ones(6)
    for _ in range(STEPS):
        u, J = _body_wrench(rows, R, x[6 : 6 + numbers], free)
        left = rows.w - x[:6] + u
        M = (np.sqrt(weights)[:, None] * J).reshape(-1, J.shape[2])
        step = np.asarray(
            np.linalg.lstsq(M.T @ M, M.T @ (np.sqrt(weights) * left).ravel(), rcond=None)[0], dtype=np.float64
        )
        x[: 6 + numbers] += step[: 6 + numbers]
        R = np.asarray(R @ rotation_exp(step[6 + numbers :])) if free else R
        u, J = _body_wrench(rows, R, x[6 : 6 + numbers], free)
        left = rows.w - x[:6] + u
        weights = 1.0 / np.maximum(np.mean(left**2, axis=0), 1e-12)
    return _Solved(x, R, weights, left, J, numbers)


def _body_wrench(rows: _Rows, R: Floats, numbers: Floats, free: bool) -> tuple[Floats, Floats]:
    """What moves the body (N, 6) in the sensor's axes, and derivatives (N, 6, k) of its reading."""
    rotated = np.concatenate([R.T @ rows.Y[:, half, : len(numbers)] for half in (slice(0, 3), slice(3, 6))], axis=1)
    u = rotated @ numbers
    parts = [np.broadcast_to(np.eye(6), (len(u), 6, 6)), -rotated]
    if free:
        parts.append(-np.concatenate([skew(u[:, :3]), skew(u[:, 3:])], axis=1))
    return u, np.concatenate(parts, axis=2)


def _predict(rows: _Rows, fit: _Solved) -> Floats:
    return np.asarray(fit.x[:6] - _body_wrench(rows, fit.R, fit.x[6 : 6 + fit.numbers], free=False)[0])


def _refuse_wrong_readings(rows: _Rows, fit: _Solved, free: bool) -> None:
    spread = np.sqrt(np.mean(np.var(rows.w[:, :3], axis=0)))

    def follows_gravity(one: _Solved) -> bool:
        return bool(one.x[6] > 0.0 and one.force_left < UNEXPLAINED * spread)

    if follows_gravity(fit):
        return
    if follows_gravity(_solve(replace(rows, w=-rows.w), FIRST, free)):
        raise ObservationError(
            "The sensor reads what the flange does to the tool, of the other sign: change the sign of all six columns, fx_n to "
            "mz_nm, so that a tool that hangs pulls down. Two columns that were exchanged, such as x and y, look the same.",
            code="wrench_sign",
        )
    raise ObservationError(
        "The force hardly follows gravity: look whether it is in the sensor's own axes (not in those of the base), in N, in "
        "the order x, y, z, with the joints of the same moment, and whether the sensor was zeroed on the way.",
        code="wrench_unexplained",
    )


def _jackknife(rows: _Rows, fit: _Solved) -> Floats:
    """Covariance of ``x`` by leaving out each block, widened for how few they are (Bell and McCaffrey 2002)."""
    _, block = np.unique(rows.block, return_inverse=True)
    count = int(block.max()) + 1
    A, b = np.zeros((count, *2 * (len(fit.x),))), np.zeros((count, len(fit.x)))
    np.add.at(A, block, np.einsum("nia,i,nib->nab", fit.J, fit.weights, fit.J))
    np.add.at(b, block, np.einsum("nia,i,ni->na", fit.J, fit.weights, fit.residuals))
    scale = 1.0 / np.sqrt(np.diag(A.sum(axis=0)))
    A, b = A * scale * scale[:, None], b * scale
    moved = -scale * np.linalg.solve(A.sum(axis=0) - A, b[:, :, None])[:, :, 0]
    apart = moved - moved.mean(axis=0)
    widened = (float(stdtrit(count - 1, 0.975)) / QUANTILE) ** 2
    return np.asarray(apart.T @ apart * ((count - 1) / count) * widened)
