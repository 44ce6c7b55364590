"""Compliance and reversal error of each joint from two encoders: the motor's, and one on the link behind gear and backlash.

Their difference is the joint's own: what deflects under the load, what changes with the direction, and, where the two
were not read at the same instant, a delay. The delay is fitted beside the others because friction makes the torque
follow the speed: without it, compliance and reversal error stand in for it and come out many times too large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects import make_effect
from kilter_core.errors import ObservationError, TooFewPosesError
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_core.procedures.inclinometers import JointParameter, LinearFit, residual_norm
from kilter_core.types import Bools, Floats, Ints

NAMES = (("compliance", "rad/(N m)"), ("backlash", "rad"), ("encoder_delay", "s"))
FEWEST_ROWS = 50
STILL = 1e-6  # rad or m: a channel or a joint whose readings stay within this never moves
RESTING = 1e-3  # share of the largest speed below which a joint without a direction column counts as resting
CHANGES = 1e-6  # share of a column that must change at all
APART = 0.05  # share of that change that must be left beside the others for the parameter to be told apart
REASONS = (
    "the load about this axis never changes, or only with speed and direction: move it under another load",
    "the joint never reverses: move it in both directions",
    "the speed never changes apart from load and direction, or was not measured: move at several speeds (qd1_deg_s ...)",
)
NEGATIVE = (
    "it would be negative ({:.1e} ± {:.1e} rad/(N m)), and nothing yields against its load: here friction or acceleration "
    "make the load. Move the joint slowly under changing gravity, or measure it at the end effector"
)


@dataclass(frozen=True)
class Spread:
    """Standard deviation of link minus motor angle of one motion, its mean taken out: ``raw``, and what is ``left``."""

    raw: float
    left: float


@dataclass(frozen=True)
class LinkJoint:
    """One joint: its parameters (SI); the motions it was fitted to and those it predicts, None where it did not move.

    ``dead`` says why it has neither.
    """

    joint: int
    parameters: tuple[JointParameter, ...]
    fitted: tuple[Spread | None, ...] = ()
    predicted: tuple[Spread | None, ...] = ()
    dead: str | None = None


def link_joints(robot: Robot, train: Sequence[Observations], held: Sequence[Observations] = ()) -> list[LinkJoint]:
    """Measure every joint whose link side was read; each of ``train`` and ``held`` is one motion, in the order of time.

    Every motion has an offset of its own for each joint. A measured torque is taken for the load (the motor holds
    against it, so the load is its negative); without one the load is that of the link masses.

    Raises:
        ObservationError: no link-side encoder at all. TooFewPosesError: fewer than 50 rows of motion.

    """
    if not train or any(rows.link_q is None for rows in (*train, *held)):
        raise ObservationError(
            "These rows hold no angles behind the gear: upload link1_deg ... linkn_deg or tilt1x_deg ..., or "
            "give inclinometer readings.",
            missing=["link_q"],
        )
    if sum(map(len, train)) < FEWEST_ROWS:
        raise TooFewPosesError(
            f"{sum(map(len, train))} rows are not a motion: {FEWEST_ROWS} are needed, some thousands are better."
        )
    trained, unseen = ([_Motion.from_observations(robot, rows) for rows in part] for part in (train, held))
    return [_of_joint(robot, j, trained, unseen) for j in range(robot.n_joints)]


def calibration_from_encoders(robot: Robot, found: Sequence[LinkJoint]) -> Calibration:
    """The nominal robot with compliance and reversal error; the delay is the recording's, and left out."""
    model = RobotModel(robot, tuple(make_effect(e) for e in ("axial_compliance", "backlash")))
    values = model.values0()
    for p in (p for joint in found for p in joint.parameters):
        if p.value is not None and p.name in model.names:
            values[model.names.index(p.name)] = p.value
    return Calibration(model, values)


@dataclass(frozen=True)
class _Motion:
    """``apart (N, n)`` link minus motor; regressors ``columns (N, n, 3)``: load, half the direction, minus the speed."""

    apart: Floats
    columns: Floats
    moved: Bools
    alive: Bools

    @staticmethod
    def from_observations(robot: Robot, rows: Observations) -> _Motion:
        assert rows.link_q is not None
        load = (
            -rows.tau
            if rows.tau is not None
            else RobotModel(robot, (make_effect("axial_compliance"),)).batch(rows).axial
        )
        speed = np.zeros_like(rows.q) if rows.qd is None else rows.qd
        way = rows.direction if rows.direction is not None else _ways(speed)
        alive = np.isfinite(rows.link_q).all(axis=0) & (np.ptp(np.nan_to_num(rows.link_q), axis=0) > STILL)
        columns = np.stack([load, 0.5 * way, -speed], axis=2)
        return _Motion(rows.link_q - rows.q, columns, np.ptp(rows.q, axis=0) > STILL, alive)


def _of_joint(robot: Robot, j: int, train: list[_Motion], held: list[_Motion]) -> LinkJoint:
    name = robot.joints[j].name
    moved = [m for m in train if m.moved[j]]
    if not moved:
        return _unfitted_joint(j, train, f"joint {name} never moves: move it in both directions")
    if not all(m.alive[j] for m in moved):
        return _unfitted_joint(
            j, train, f"the link-side encoder of joint {name} is constant while the joint moves: a dead channel"
        )
    columns = np.concatenate([m.columns[:, j] for m in moved])
    owner = np.repeat(np.arange(len(moved)), [len(m.apart) for m in moved])
    offsets = np.eye(len(moved))[owner]
    y = np.concatenate([m.apart[:, j] for m in moved])
    told, reasons = _identifiable_columns(columns, offsets), list(REASONS)
    fit = LinearFit.from_columns(columns, told, offsets, y)
    sigma = _sigma(fit, owner)
    if 0 in told and fit.solution[0] < 0.0:  # told is in order: compliance comes first
        reasons[0] = NEGATIVE.format(fit.solution[0], sigma[0])
        fit = LinearFit.from_columns(columns, told[1:], offsets, y)
        sigma = _sigma(fit, owner)
    values = np.zeros(3)
    values[list(fit.told)] = fit.solution[: len(fit.told)]
    parameters = tuple(fit.parameters(j, NAMES, sigma, reasons))
    spreads = [[_spread(m, j, values) for m in motions] for motions in (train, held)]
    return LinkJoint(j, parameters, tuple(spreads[0]), tuple(spreads[1]))


def _unfitted_joint(j: int, train: list[_Motion], why: str) -> LinkJoint:
    rows = sum(len(m.apart) for m in train)
    none = tuple(JointParameter(f"{s}_{j + 1}", j, u, None, None, rows, why) for s, u in NAMES)
    return LinkJoint(j, none, dead=why)


def _spread(motion: _Motion, j: int, values: Floats) -> Spread | None:
    if not (motion.alive[j] and motion.moved[j]):
        return None
    apart = motion.apart[:, j]
    return Spread(float(apart.std()), float((apart - motion.columns[:, j] @ values).std()))


def _ways(speed: Floats) -> Floats:
    """Direction of motion from the speed, 0 while a joint all but rests."""
    return np.where(np.abs(speed) > RESTING * np.max(np.abs(speed), axis=0, initial=0.0), np.sign(speed), 0.0)


def _identifiable_columns(columns: Floats, offsets: Floats) -> list[int]:
    """Columns that change, apart from the offsets, as no combination of the others does."""
    counts = offsets.sum(axis=0)
    change = columns - offsets @ ((offsets.T @ columns) / counts[:, None])
    size, whole = np.linalg.norm(change, axis=0), np.linalg.norm(columns, axis=0)
    moving = [k for k in range(columns.shape[1]) if size[k] > CHANGES * whole[k]]
    told = []
    for k in moving:
        others = [c for c in moving if c != k]
        B = change[:, others] / size[others]
        if residual_norm(change[:, k], B) > APART * size[k]:
            told.append(k)
    return told


def _sigma(fit: LinearFit, owner: Ints) -> Floats:
    """Standard deviations of a fit whose residuals follow each other in time (Newey and West, bandwidth of Andrews).

    Rows of 4 ms are not independent: the plain formula gives sigmas several times too small.
    """
    A, left = fit.A, fit.left
    bread = np.linalg.pinv(A.T @ A)
    meat = np.zeros_like(bread)
    for motion in np.unique(owner):
        score: Floats = A[owner == motion] * left[owner == motion, None]
        meat += score.T @ score
        lags = _bandwidth(left[owner == motion])
        for lag in range(1, lags + 1):
            cross = score[lag:].T @ score[:-lag]
            meat += (1.0 - lag / (lags + 1.0)) * (cross + cross.T)
    return np.asarray(np.sqrt(np.diag(bread @ meat @ bread * (len(A) / max(len(A) - A.shape[1], 1)))))


def _bandwidth(left: Floats) -> int:
    """Lags to count for Bartlett weights, from the residual's first autocorrelation (Andrews 1991)."""
    centred = left - left.mean()
    power = float(centred @ centred)
    if len(left) < 4 or power == 0.0:
        return 0
    rho = min(max(float(centred[1:] @ centred[:-1]) / power, 0.0), 0.99)
    alpha = 4.0 * rho**2 / ((1.0 - rho) ** 2 * (1.0 + rho) ** 2)
    return int(min(1.1447 * (alpha * len(left)) ** (1.0 / 3.0), len(left) // 4))
