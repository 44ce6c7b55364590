"""Frames of robot, measurements and tool, and errors of a prediction in mm and degrees.

With flange frames (F, f), measured points p = b + R (f + F t) say R'p - f = R'b + F t. For a known base rotation R that is
linear in base and tool, by a matrix that does not depend on R. Projected on what neither can explain, the loss is quadratic
in the nine entries of R' alone, whatever the number of rows: all of SO(3) can be looked through, and the best of it is
walked to its end. Left free to be any matrix, as in the linear solution for all unknowns at once, R' collapses to zero
wherever the flange moves on a sphere (a wrist, a shoulder, a head with two axes): the tool then explains everything.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from kilter_core.measurement import Measurement
from kilter_core.measurement.markers import fit_poses
from kilter_core.model import Calibration, RobotModel
from kilter_core.parameters import degrees, mm
from kilter_core.transforms import inverse, nearest_rotation, scipy_rotation, skew
from kilter_core.types import Bools, Floats

FEWEST_POSES = 6  # nine unknowns at three numbers a pose: fewer, and the tool point would follow noise
MOST_POSES = 5000  # that a start is found from


def register(
    model: RobotModel, values: Floats, measurement: Measurement, *, base: bool = True, tool: bool = True
) -> tuple[Floats, Floats]:
    """Starting base and tool poses (4, 4) without any guess, from the model's flange poses.

    Both together are the best there are (:func:`kilter_core.measurement.frames.best_frames`), by positions and, where it
    was measured, by orientation; then the tool's rotation is the mean of (R F)' R_measured. Frames that are not free
    (``base``, ``tool``) are kept as the model has them.
    """
    if not (base or tool):
        return model.T_base, model.T_tool
    position, rotation, use = _measured_poses(measurement)
    T_base, T_tool = model.T_base.copy(), model.T_tool.copy()
    flange = _flange(model, values, measurement)
    f, F, p = flange[use, :3, 3], flange[use, :3, :3], position[use]
    if base and tool and len(p) >= FEWEST_POSES:
        some = slice(None, None, max(1, len(p) // MOST_POSES))
        turned = None if rotation is None else rotation[use][some]
        T_base, T_tool[:3, 3] = best_frames(f[some], F[some], p[some], T_tool[:3, 3], turned)
    elif base:
        T_base = _rigid(f + F @ T_tool[:3, 3], p)
    if tool:
        back = inverse(T_base)
        local = p @ back[:3, :3].T + back[:3, 3]
        T_tool[:3, 3] = np.einsum("nji,nj->ni", F, local - f).mean(axis=0)
        if rotation is not None:
            T_tool[:3, :3] = nearest_rotation(np.mean((T_base[:3, :3] @ F).transpose(0, 2, 1) @ rotation[use], axis=0))
    return T_base, T_tool


def _measured_poses(measurement: Measurement) -> tuple[Floats, Floats | None, Bools]:
    o = measurement.observations
    if measurement.marker_points is not None and o.markers_of_poses is not None:
        return fit_poses(measurement.marker_points, o.markers_of_poses)
    assert o.position is not None
    return o.position, o.rotation, measurement.tool.measured_row_mask()


def _flange(model: RobotModel, values: Floats, measurement: Measurement) -> Floats:
    """Flange poses (N, 4, 4) in the robot's base frame."""
    bare = model.in_frames(np.eye(4), np.eye(4))
    prediction = bare.predict(measurement.observations, values)
    out = np.tile(np.eye(4), (len(prediction.position), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = prediction.rotation, prediction.position
    return out


def _rigid(body: Floats, world: Floats) -> Floats:
    b, w = body.mean(axis=0), world.mean(axis=0)
    T = np.eye(4)
    T[:3, :3] = nearest_rotation((world - w).T @ (body - b))
    T[:3, 3] = w - T[:3, :3] @ b
    return T


RIDGE = 1e-4  # of a row's weight: poses that share an orientation cannot tell the tool from the base
WALKED = 6  # of the places looked at, the best, from which a walk begins
TOGETHER, STEPS = 6, 20  # steps of all walks, then of the best one
DAMPING, LEAST_DAMPING = 2e-3, 1e-13
SETTLED, ROUNDING = 1e-9, 1e-29  # shares of the loss and of all squares: a step that changes less is the last
IDENTITY = np.eye(3)
AXES = skew(IDENTITY)
LEVER = 0.1  # of the spread of the points, m that a radian of orientation counts for: positions decide where they can


def best_frames(
    f: Floats, F: Floats, p: Floats, guess: Floats, turned: Floats | None = None, near: Floats | None = None
) -> tuple[Floats, Floats]:
    """Base pose (4, 4) and tool point (3,) from flange positions f (N, 3) and rotations F (N, 3, 3) to points p (N, 3).

    ``guess (3,)`` is the tool point where the poses do not tell it, ``turned (N, 3, 3)`` the measured orientation. With a
    base rotation ``near (3, 3)`` only the minimum near it is found.
    """
    loss = _Loss(f, F, p, guess, turned)
    starts = _everywhere() if near is None else near.T[None]
    if near is None:
        starts = starts[np.argsort(loss.sum_of_squares(starts))[:WALKED]]
    turns = _refine_rotations(loss, starts, TOGETHER) if len(starts) > 1 else starts
    turn = nearest_rotation(_refine_rotations(loss, turns[[int(np.argmin(loss.sum_of_squares(turns)))]], STEPS)[0])
    shift, tool = loss.linear(turn)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn.T, turn.T @ shift + p.mean(axis=0)
    return T, tool


class _Loss:
    """Sum of squares m² that base and tool leave for a base rotation, of which R' is the inverse: |B vec(R') - d|²."""

    def __init__(self, f: Floats, F: Floats, p: Floats, guess: Floats, turned: Floats | None) -> None:
        count = len(f)
        ridge = RIDGE * np.sqrt(count)
        moved = p - p.mean(axis=0)
        # R'p, row by row: entry (i, k) of R' multiplies coordinate k of the point in equation i.
        self._turning = np.concatenate([np.einsum("ij,nk->nijk", np.eye(3), moved).reshape(-1, 9), np.zeros((3, 9))])
        self._constant = np.concatenate([f.reshape(-1), -ridge * guess])
        known = np.zeros((count, 3, 6))
        known[:, :, :3], known[:, :, 3:] = np.eye(3), F
        self._known = np.concatenate([known.reshape(-1, 6), np.hstack([np.zeros((3, 3)), ridge * np.eye(3)])])
        Q = np.linalg.qr(self._known)[0]
        both = np.column_stack([self._turning, self._constant])
        left = both - Q @ (Q.T @ both)
        if turned is not None:
            left = np.concatenate([left, _of_orientation(F, turned, LEVER * float(np.sqrt(np.mean(moved**2))))])
        R = np.asarray(np.linalg.qr(left, mode="r"))
        self.B, self.d = R[:, :9], R[:, 9]
        self._turned = np.einsum("alj,mij->ilam", AXES, self.B.reshape(-1, 3, 3)).reshape(9, -1)

    def sum_of_squares(self, turns: Floats) -> Floats:
        """Loss (K,) of rotations R' (K, 3, 3)."""
        return np.asarray(np.sum(self.residual(turns) ** 2, axis=1))

    def residual(self, turns: Floats) -> Floats:
        """Residuals (K, m) of rotations."""
        return np.asarray(turns.reshape(-1, 9) @ self.B.T - self.d)

    def slopes(self, turns: Floats) -> Floats:
        """Derivatives (K, 3, m) of the residuals by rotations about the axes."""
        return np.asarray((turns.reshape(-1, 9) @ self._turned).reshape(len(turns), 3, -1))

    def linear(self, turn: Floats) -> tuple[Floats, Floats]:
        """Place (3,) of the base from the middle of the points, in the base's axes, and tool point (3,) for one rotation R'."""
        x = np.linalg.lstsq(self._known, self._turning @ turn.reshape(-1) - self._constant, rcond=None)[0]
        return np.asarray(x[:3]), np.asarray(x[3:])


def _of_orientation(F: Floats, turned: Floats, lever: float) -> Floats:
    """Rows (9 N, 10) that say how far R' S - F T is from zero for the best tool rotation T, m."""
    rows = np.einsum("ij,nkl->niljk", np.eye(3), turned).reshape(len(F), 9, 9)
    known = np.einsum("nik,lm->nilkm", F, np.eye(3)).reshape(-1, 9)
    Q = np.linalg.qr(known)[0]
    left = rows.reshape(-1, 9)
    return np.asarray(lever * np.column_stack([left - Q @ (Q.T @ left), np.zeros(len(left))]))


def _refine_rotations(loss: _Loss, turns: Floats, steps: int) -> Floats:
    """Rotations R' (K, 3, 3) after damped Gauss-Newton steps on SO(3), each from its own start."""
    size = float(np.sum(loss.B**2)) or 1.0  # points that are all one tell no rotation from another
    damping, left = np.full(len(turns), DAMPING * size), loss.residual(turns)
    now, rounding = (left * left).sum(axis=1), ROUNDING * float(loss.d @ loss.d)
    for _ in range(steps):
        J = loss.slopes(turns)
        H = J @ J.transpose(0, 2, 1) + damping[:, None, None] * IDENTITY
        step = -np.linalg.solve(H, J @ left[:, :, None])[:, :, 0]
        there = np.asarray(turns @ _rotations(np.asarray(step, dtype=np.float64)))
        then_left = loss.residual(there)
        then = (then_left * then_left).sum(axis=1)
        better = then < now
        change = float(np.abs(now - then).max())  # a walk that got worse goes on, with more damping
        turns, left = np.where(better[:, None, None], there, turns), np.where(better[:, None], then_left, left)
        now = np.where(better, then, now)
        damping = np.maximum(np.where(better, damping / 10.0, damping * 10.0), LEAST_DAMPING * size)
        if change <= SETTLED * now.min() + rounding:
            break
    return turns


def _rotations(w: Floats) -> Floats:
    """Rotations (K, 3, 3) about w (K, 3), by 2 atan(|w| / 2): Cayley's formula, which of a small step is a rotation by |w|."""
    W = (w @ AXES.reshape(3, 9)).reshape(-1, 3, 3)
    return np.asarray(IDENTITY + (W + 0.5 * W @ W) / (1.0 + 0.25 * (w * w).sum(axis=1))[:, None, None])


@cache
def _everywhere() -> Floats:
    """Rotations (60, 3, 3) evenly over SO(3), the icosahedron's: no rotation is farther than 45 degrees from one of them."""
    return np.asarray(scipy_rotation().create_group("I").as_matrix())


@dataclass(frozen=True)
class Errors:
    """Point errors (K, 3) m, measured minus predicted, and orientation errors (K,) rad where measured.

    Distances and contacts have errors of one number, (K, 1).
    """

    points: Floats
    turns: Floats | None

    @staticmethod
    def from_calibration(calibration: Calibration, measurement: Measurement) -> Errors:
        """Errors of a calibration; every seen marker counts as a point."""
        return Errors(*measurement.errors(calibration))

    @property
    def mean(self) -> float:
        """Mean size of the errors of points, m."""
        return float(np.linalg.norm(self.points, axis=1).mean())

    @staticmethod
    def concatenate(parts: list[Errors]) -> Errors:
        """Pool the errors of several folds."""
        turns = [part.turns for part in parts if part.turns is not None]
        return Errors(np.concatenate([p.points for p in parts]), np.concatenate(turns) if turns else None)

    def to_document(self) -> dict[str, float]:
        """Mean, rms, 95th percentile and maximum of the 3-D error, rms per axis, in mm; mean orientation error in deg."""
        size = mm(np.asarray(np.linalg.norm(self.points, axis=1)))
        out = {
            "mean_mm": size.mean(),
            "rms_mm": np.sqrt(np.mean(size**2)),
            "p95_mm": np.percentile(size, 95),
            "max_mm": size.max(),
        }
        if self.points.shape[1] == 3:
            axes = mm(np.asarray(np.sqrt(np.mean(self.points**2, axis=0))))
            out |= dict(zip(("x_mm", "y_mm", "z_mm"), axes, strict=True))
        if self.turns is not None:
            out["orientation_deg"] = degrees(self.turns.mean())
        return {key: float(value) for key, value in out.items()}


def metrics_document(train: dict[str, Errors], held: dict[str, Errors], left_out: int = 0) -> dict[str, Any]:
    """The ``metrics`` of the contract: each stage's errors on the rows fitted and, unless empty, on those held out.

    ``left_out`` rows held out are not among the latter.
    """

    def block(errors: dict[str, Errors], without: int) -> dict[str, Any]:
        n = len(next(iter(errors.values())).points)
        return {"n": n, "left_out": without, **{name: e.to_document() for name, e in errors.items()}}

    return {"train": block(train, 0), "validation": block(held, left_out) if held else None}
