"""Clearance, backlash and stiffness of each joint from inclinometer readings (thesis 4.4.1 and 5.3).

An inclinometer on the link after a joint, against one before it, shows what the joint adds to the commanded angle. Only
differences count, so every joint, axis and series has an offset of its own. The parts are told apart by the load:
clearance tilts towards the transverse moment, backlash follows the sign of the axial moment, compliance its size.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects import make_effect
from kilter_core.errors import FindingDocument, ObservationError
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_core.parameters import degrees
from kilter_core.types import Bools, Floats, Ints

EFFECTS = ("clearance_tilt", "backlash_load", "axial_compliance")
NAMES = (("clearance", "rad"), ("backlash_load", "rad"), ("compliance", "rad/(N m)"))
AXES = "xyz"
UPRIGHT = 0.95  # cosine to the vertical from which an inclinometer does not see rotations about an axis (18 degrees)
LEAST_MOMENT_NM = 0.01
APART = 0.05  # share of a column that must be left beside the others for its parameter to be told apart
LARGE = 5.0  # resolutions of scatter from which something else than reading is wrong
MENDED = 0.5  # share of that scatter below which another axis explains the readings
TRIAL_POSES = 200


@dataclass(frozen=True)
class Log:
    """Readings (N,) rad of joints (N,) about axes (N,) (0 x, 1 y, 2 z of the joint frame) at ``q (N, n)``.

    A reading is the rotation of the joint beyond its command, up to a constant for each joint, axis and ``series (N,)``.
    ``payload_com (N, 3)`` m is where the payload has its centre in the tool frame, the tool point when None.
    """

    q: Floats
    joint: Ints
    axis: Ints
    reading: Floats
    payload_kg: Floats
    series: Ints
    resolution: float = math.radians(0.001)
    payload_com: Floats | None = None

    @staticmethod
    def from_observations(rows: Observations, resolution: float) -> Log:
        """Every reading of a joint; sessions are series, a payload that is not said is none.

        Raises:
            ObservationError: the rows have no readings of inclinometers.

        """
        if rows.tilt is None:
            raise ObservationError("These rows hold no readings of inclinometers: upload tilt1x_deg and so on.")
        row, joint, axis = np.nonzero(~np.isnan(rows.tilt[:, : rows.q.shape[1]]))
        if not len(row):
            raise ObservationError(
                "These rows hold readings of the base alone, which say nothing of a joint: upload tilt1x_deg and so on, or "
                "name them beside the tool's rows in identify."
            )
        payload = np.zeros(len(rows)) if rows.payload_kg is None else rows.payload_kg
        series = np.zeros(len(rows), dtype=np.int64) if rows.session is None else rows.session
        reading = rows.tilt[row, joint, axis]
        return Log(rows.q[row], joint, axis, reading, payload[row], series[row], resolution)

    def observations(self) -> Observations:
        """The configurations as rows."""
        return Observations(self.q, payload_kg=self.payload_kg, payload_com=self.payload_com)


def tilting(robot: Robot) -> RobotModel:
    """The robot with clearance, backlash and compliance in every joint."""
    return RobotModel(robot, tuple(make_effect(e) for e in EFFECTS))


def regressors(robot: Robot, rows: Observations) -> tuple[Floats, Floats]:
    """Rotation (N, n, 3, 3) about x, y, z of each joint by C, b and c; cosine (N, n, 3) of the axes to the load force."""
    model = tilting(robot)
    batch = model.batch(rows)
    out = np.zeros((*rows.q.shape, 3, 3))
    for k, effect in enumerate(model.effects):
        count = len(effect.parameters(robot))
        for d in effect.local(batch, np.zeros(count)).derivatives:
            if d.xi is not None:
                out[:, d.joint, :, k] += d.xi[:, 3:]
            if d.dq is not None:
                out[:, d.joint, 2, k] += d.dq
    force = batch.wrench[:, :, :3]
    size = np.linalg.norm(force, axis=2, keepdims=True)
    return out, force / np.where(size > 1e-9, size, 1.0)


def joint_parameters(robot: Robot, log: Log) -> tuple[list[JointParameter], list[dict[str, str]]]:
    """Clearance, backlash and compliance of every joint in the log, and warnings.

    Raises:
        ObservationError: an axis that stands upright, which no inclinometer sees; names the row.

    """
    whole, upright = regressors(robot, log.observations())
    rows = np.arange(len(log.joint))
    columns, cosine = whole[rows, log.joint, log.axis], upright[rows, log.joint, log.axis]
    if np.any(np.abs(cosine) > UPRIGHT):
        bad = int(np.argmax(np.abs(cosine)))
        raise ObservationError(
            f"Reading {bad + 1}: axis {AXES[log.axis[bad]]} of joint {robot.joints[log.joint[bad]].name} stands upright "
            "there, and an inclinometer does not see rotations about the vertical. Check the axis, or take another pose.",
            row=bad,
        )
    found: list[JointParameter] = []
    warnings: list[dict[str, str]] = []
    for j in np.unique(log.joint):
        mine = log.joint == j
        parameters, scatter = _of_joint(robot, int(j), log, columns[mine], mine)
        found += parameters
        warnings += _negative(robot, parameters)
        if scatter > LARGE * log.resolution:
            swapped = _other_axis(robot, int(j), log, whole[rows, log.joint], mine, scatter)
            if swapped is not None:
                warnings.append(swapped)
                continue
            warnings.append(
                FindingDocument.make(
                    "readings_scatter",
                    f"Readings of joint {robot.joints[j].name} scatter by {degrees(scatter):.4f} deg: look for a "
                    "wrong axis, a changed mounting without a new series, or masses that are not the robot's.",
                    joint=robot.joints[j].name,
                )
            )
    return found, warnings


def weightless_joints(robot: Robot) -> list[int]:
    """Joints about whose axes gravity has no moment, in any of 200 poses: no inclinometer can measure them."""
    limits = np.where(np.isfinite(robot.limits), robot.limits, np.sign(robot.limits) * math.pi)
    q = np.random.default_rng(0).uniform(limits[:, 0], limits[:, 1], (TRIAL_POSES, robot.n_joints))
    axial = regressors(robot, Observations(q, payload_kg=np.ones(TRIAL_POSES)))[0][:, :, 2, 2]
    return [int(j) for j in np.flatnonzero(np.max(np.abs(axial), axis=0) < LEAST_MOMENT_NM)]


def calibration_from_inclinations(robot: Robot, found: list[JointParameter]) -> Calibration:
    """The nominal robot with the measured effects: a start for ``tilt_first``. What was not measured stays zero."""
    model = tilting(robot)
    values = model.values0()
    for p in found:
        if p.value is not None:
            values[model.names.index(p.name)] = p.value
    return Calibration(model, values)


def _of_joint(robot: Robot, j: int, log: Log, columns: Floats, mine: Bools) -> tuple[list[JointParameter], float]:
    """Least squares of one joint over C, b, c and its offsets; and the scatter left."""
    kinds = np.unique(np.stack([log.axis[mine], log.series[mine]], axis=1), axis=0, return_inverse=True)[1].reshape(-1)
    offsets = np.eye(int(kinds.max()) + 1)[kinds]
    told = [k for k in range(3) if _is_independent_column(columns, k, offsets)]
    fit = LinearFit.from_columns(columns, told, offsets, log.reading[mine])
    scatter = float(np.sqrt(np.sum(fit.left**2) / max(len(fit.A) - fit.A.shape[1], 1)))
    # Rounding to the resolution is uniform noise; few readings can look better than that by luck.
    noise = max(scatter, log.resolution / math.sqrt(12.0))
    sigma = noise * np.sqrt(np.diag(np.linalg.pinv(fit.A.T @ fit.A)))
    return fit.parameters(j, NAMES, sigma, [_reason(k, columns) for k in range(3)]), scatter


def _other_axis(robot: Robot, j: int, log: Log, every: Floats, mine: Bools, scatter: float) -> dict[str, str] | None:
    """Whether the readings about one axis fit those of another one, or with the sign reversed; the warning if so."""
    best, found = MENDED * scatter, None
    for declared in np.unique(log.axis[mine]):
        those = mine & (log.axis == declared)
        for other, sign in ((o, s) for o in range(3) for s in (1.0, -1.0) if (o, s) != (declared, 1.0)):
            axis = np.where(those, other, log.axis)
            reading = np.where(those, sign * log.reading, log.reading)
            columns = every[np.arange(len(axis)), axis]
            # Offsets keep the declared axis: what was mounted together stays together.
            parameters, left = _of_joint(robot, j, replace(log, reading=reading), columns[mine], mine)
            if left < best and not _negative(robot, parameters):
                best, found = left, (int(declared), other, sign)
    if found is None:
        return None
    name, (declared, other, sign) = robot.joints[j].name, found
    true = f"{'-' if sign < 0 else ''}{AXES[other]}"
    return FindingDocument.make(
        "inclinometer_axis",
        f"Readings of joint {name} given about {AXES[declared]} fit axis {true} of its frame: they scatter by "
        f"{degrees(scatter):.4f} deg as given and by {degrees(best):.4f} deg so. Remount the inclinometer, or "
        "correct the axis (for a minus the sign of the readings), and send them again.",
        joint=name,
    )


def _negative(robot: Robot, parameters: list[JointParameter]) -> list[dict[str, str]]:
    """A joint that deflects against its load has its inclinometer the wrong way round."""
    below = [p for p in parameters if p.value is not None and p.value < -3.0 * (p.sigma or 0.0)]
    if not below:
        return []
    joint, names = robot.joints[below[0].joint].name, ", ".join(p.name for p in below)
    return [
        FindingDocument.make(
            "inclinometer_axis",
            f"{names} of joint {joint} would be negative, against the load: the inclinometer is the wrong way "
            "round (readings before the joint minus after it), or the masses are not the robot's. Reverse the sign of the "
            "readings.",
            joint=joint,
        )
    ]


def _is_independent_column(columns: Floats, k: int, offsets: Floats) -> bool:
    """Whether a column is more than a combination of the others and the offsets."""
    size = float(np.linalg.norm(columns[:, k]))
    if size < (LEAST_MOMENT_NM if k == 2 else 0.1):
        return False
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    others = np.hstack([np.delete(columns / scale, k, axis=1), offsets])
    return residual_norm(columns[:, k], others) > APART * size


def _reason(k: int, columns: Floats) -> str:
    if k > 0 and np.max(np.abs(columns[:, 2])) < LEAST_MOMENT_NM:
        return "no gravity moment about this axis in these poses: measure it at the end effector (thesis 4.4.1)"
    return (
        "the transverse load never changes sides: add readings about x or y with the load on the other side",
        "the axial moment never changes its sign, or only together with its size: add a pair with small moments of both signs",
        "the axial moment never changes its size: add poses with the arm stretched and folded, or another payload",
    )[k]


@dataclass(frozen=True)
class JointParameter:
    """One measured parameter, SI; ``reason`` says why it could not be measured."""

    name: str
    joint: int
    unit: str
    value: float | None
    sigma: float | None
    readings: int
    reason: str | None = None


@dataclass(frozen=True)
class LinearFit:
    """Least squares over the columns that are ``told`` apart and the offsets: ``A (N, K)``, solution and what is left."""

    A: Floats
    solution: Floats
    left: Floats
    told: tuple[int, ...]

    @staticmethod
    def from_columns(columns: Floats, told: Sequence[int], offsets: Floats, y: Floats) -> LinearFit:
        """Fit these of the columns (N, C), and every offset (N, S)."""
        A = np.hstack([columns[:, list(told)], offsets])
        solution = np.asarray(np.linalg.lstsq(A, y, rcond=None)[0])
        return LinearFit(A, solution, y - A @ solution, tuple(told))

    def parameters(
        self, joint: int, names: Sequence[tuple[str, str]], sigma: Floats, reasons: Sequence[str]
    ) -> list[JointParameter]:
        """One parameter for each (stem, unit), with the reason where its column was not told apart."""
        out = []
        for k, ((stem, unit), reason) in enumerate(zip(names, reasons, strict=True)):
            place = self.told.index(k) if k in self.told else None
            value, wide = (None, None) if place is None else (float(self.solution[place]), float(sigma[place]))
            why = reason if place is None else None
            out.append(JointParameter(f"{stem}_{joint + 1}", joint, unit, value, wide, len(self.left), why))
        return out


def residual_norm(column: Floats, others: Floats) -> float:
    """Length of what of a column (N,) no combination of others (N, K) makes up."""
    return float(np.linalg.norm(column - others @ np.linalg.lstsq(others, column, rcond=None)[0]))
