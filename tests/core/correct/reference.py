"""The stated reference of the correction: the inverse of the whole model, iterated to convergence (thesis eq. 5.22).

Readable and slow: what the compiled program of :mod:`kilter_core.correct.program`
answers is held against it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from kilter_core.errors import OptionError
from kilter_core.model import Calibration, Prediction, RobotModel
from kilter_core.observations import Observations
from kilter_core.transforms import inverse, rotation_log
from kilter_core.types import Bools, Floats


class Status(IntEnum):
    """Why a setpoint was or was not corrected; the numbers are those of the stream's messages."""

    OK = 0
    NOT_FINITE = 5
    JOINT_LIMIT = 6
    CORRECTION_TOO_LARGE = 7


@dataclass(frozen=True)
class CorrectOptions:
    """How to correct. ``task`` "position", the default, holds x, y, z and then the orientation; "pose" holds all alike.

    The orientation is given up where a radian of the joints rotates the tool by less than ``least_leverage`` in its weakest
    direction. For "pose" ``orientation_weight_m`` sets 1 rad against metres of position. Corrections beyond ``max_joint_rad``
    (for prismatic joints ``max_shift_m``) or moving the tool by more than ``max_shift_m`` are refused.
    """

    task: str = "position"
    least_leverage: float = 0.2
    orientation_weight_m: float = 0.2
    max_joint_rad: float = math.radians(1.0)
    max_shift_m: float = 0.005
    tolerance_m: float = 1e-8
    iterations: int = 15


@dataclass(frozen=True)
class Correction:
    """Corrected joints of N setpoints.

    ``q (N, n)``, NaN where ``status (N,)`` is not OK, so there is nothing to misuse; ``error_removed (N, 3)`` m, the tool
    error predicted without correction, in the wanted base frame; ``residual (N,)`` m left over in the held rows;
    ``converged (N,)``; ``held`` names the rows of the task that were held.
    """

    q: Floats
    error_removed: Floats
    residual: Floats
    converged: Bools
    status: NDArray[np.uint16]
    held: tuple[str, ...]


def correct(
    calibration: Calibration,
    q: Floats,
    *,
    qd: Floats | None = None,
    qdd: Floats | None = None,
    direction: Floats | None = None,
    payload_kg: Floats | None = None,
    payload_com: Floats | None = None,
    temperature_c: Floats | None = None,
    base_tilt: tuple[Floats, Floats] | None = None,
    options: CorrectOptions | None = None,
) -> Correction:
    """Joints (N, n) that put the real arm where the nominal arm should be at ``q (N, n)``.

    Rows without a payload carry the robot's default load. Wanted is the nominal chain at q in the wanted frames of the
    calibration, actual the identified chain at the corrected joints in the identified frames, with all effects that act
    on the arm; both seen from the wanted base. The step is exact for a linear arm, so it is repeated until nothing moves.

    Raises:
        OptionError: an unknown task.

    """
    options = options or CorrectOptions()
    if options.task not in ("position", "pose"):
        raise OptionError(f"task is {options.task!r}: give position or pose.", option="task")
    model, values = _on_the_arm(calibration)
    load = calibration.robot.load
    ideal = calibration.nominal_in_wanted_frames()
    ideal = replace(ideal, model=replace(ideal.model, T_base=np.eye(4)))
    finite = np.asarray(np.isfinite(q).all(axis=1))
    safe = np.where(finite[:, None], q, 0.0)
    conditions = Observations(safe, qd=qd, qdd=qdd, direction=direction, temperature_c=temperature_c)
    x, y = base_tilt or (None, None)
    conditions = replace(conditions, payload_kg=payload_kg, payload_com=payload_com, base_tilt_x=x, base_tilt_y=y)
    conditions = conditions if load is None else conditions.carrying(load.mass, load.com)
    wanted = ideal.predict(Observations(safe))
    before = model.predict(conditions, values)
    whole = options.task == "pose"
    weight = np.array([1.0] * 3 + [options.orientation_weight_m if whole else 1.0] * 3)
    held = 6 if whole else 3
    out = safe.copy()
    for _ in range(options.iterations):
        actual, J = model.joint_jacobian(replace(conditions, q=out), values)
        step = _step(J * weight[:, None], _task_error(wanted, actual) * weight, out - safe, options)
        out = out + step
        if np.max(np.abs(step), initial=0.0) < options.tolerance_m:
            break
    error = (_task_error(wanted, model.predict(replace(conditions, q=out), values)) * weight)[:, :held]
    residual = np.linalg.norm(error, axis=1)
    removed = before.position - wanted.position
    status = _status(calibration, finite, out, safe, removed, options)
    return Correction(
        q=np.where(status[:, None] == Status.OK, out, np.nan),
        error_removed=removed,
        residual=residual,
        converged=residual < 10 * options.tolerance_m,
        status=status,
        held=("x", "y", "z", "rx", "ry", "rz")[:held],
    )


def _on_the_arm(calibration: Calibration) -> tuple[RobotModel, Floats]:
    """Model seen from the wanted base frame, without the errors of the instrument."""
    arm = tuple(e for e in calibration.model.effects if e.stage != "measurement")
    kept = calibration.with_effects(arm)
    model, values = kept.model.absorb_frame_increments(kept.values)
    seen_from = inverse(calibration.nominal_in_wanted_frames().model.T_base)
    return replace(model, T_base=seen_from @ model.T_base), values


def _task_error(wanted: Prediction, actual: Prediction) -> Floats:
    """Position and rotation vector (N, 6) from actual to wanted."""
    rotation = rotation_log(wanted.rotation @ actual.rotation.transpose(0, 2, 1))
    return np.hstack([wanted.position - actual.position, rotation])


def _step(J: Floats, error: Floats, so_far: Floats, options: CorrectOptions) -> Floats:
    """Next change (N, n) of corrections ``so_far``, from weighted rows of task."""
    if options.task == "pose":
        return _damped_step(J, error)
    return _point_first(J, error, so_far, options.least_leverage) - so_far


def _point_first(J: Floats, error: Floats, so_far: Floats, least_leverage: float) -> Floats:
    """Correction (N, n) that minimises ``|dq|² + |angle left|² / d²`` among those that leave no error of the point.

    Its dual form: dq = J' y with (J J' + D) y = error + J so_far, where D is d² in the rows of the orientation. The
    leverage h is 1 / trace(S⁻¹), S what the joints can rotate the tool while the point stands still; below
    h0 = ``least_leverage``² it is d² = (h0 - h)² / 4 h0. Fewer than six joints cannot rotate the tool at will: h is 0.
    """
    A = J @ J.transpose(0, 2, 1)
    least = least_leverage**2
    leverage = np.zeros(len(J))
    if J.shape[2] >= 6:
        S = A[:, 3:, 3:] - A[:, 3:, :3] @ np.linalg.pinv(A[:, :3, :3], hermitian=True) @ A[:, :3, 3:]
        leverage = 1.0 / np.sum(1.0 / np.maximum(np.linalg.eigvalsh(S), 1e-15), axis=1)
    short = np.maximum(least - leverage, 0.0)
    A[:, [3, 4, 5], [3, 4, 5]] += (0.25 * short**2 / least)[:, None]
    given = error + np.einsum("nij,nj->ni", J, so_far)
    y = np.einsum("nij,nj->ni", np.linalg.pinv(A, rcond=1e-14, hermitian=True), given)
    return np.asarray(np.einsum("nij,ni->nj", J, y))


def _damped_step(J: Floats, error: Floats, floor: float = 1e-3) -> Floats:
    """Least-norm joint step (N, n); below the singular value ``floor`` (m per rad) the step is damped, so it stays bounded."""
    U, s, Vt = np.linalg.svd(J, full_matrices=False)
    short = np.maximum(1.0 - (s / floor) ** 2, 0.0)
    gain = s / (s**2 + short * floor**2)
    return np.asarray(np.einsum("nkj,nk->nj", Vt, gain * np.einsum("nik,ni->nk", U, error)))


def _status(
    calibration: Calibration,
    finite: Bools,
    out: Floats,
    q: Floats,
    removed: Floats,
    options: CorrectOptions,
) -> NDArray[np.uint16]:
    robot = calibration.robot
    largest = np.array([options.max_joint_rad if j.kind == "revolute" else options.max_shift_m for j in robot.joints])
    status = np.zeros(len(q), dtype=np.uint16)
    outside = ((out < robot.limits[:, 0]) | (out > robot.limits[:, 1])).any(axis=1)
    large = (np.abs(out - q) > largest).any(axis=1) | (np.linalg.norm(removed, axis=1) > options.max_shift_m)
    status[outside] = Status.JOINT_LIMIT
    status[large] = Status.CORRECTION_TOO_LARGE
    status[~finite] = Status.NOT_FINITE
    return status
