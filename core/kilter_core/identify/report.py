"""An identification in the units people read, with what it could not tell said in words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.fleet.said import resting
from kilter_core.identify.identifiable.identifiability import NullDirection, identifiable
from kilter_core.identify.identifiable.identifiable_sums import Known
from kilter_core.identify.rows.noise import Repeats
from kilter_core.identify.uncertainty.intervals import Intervals
from kilter_core.identify.uncertainty.workspace_uncertainty import workspace_uncertainty
from kilter_core.measurement.marker_checks import bending
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_core.parameters import display_unit_and_scale, mm
from kilter_core.transforms import xyz_rpy_from_pose
from kilter_core.types import Bools, Floats

_TURNS = frozenset(f"{frame}_{axis}" for frame in ("base", "tool") for axis in ("rx", "ry", "rz"))
LARGE = 0.01  # share of the workspace left after the fit that is worth a warning
STILL_RAD = 1e-6  # a joint whose readings stay within this never moved


def parameter_rows(calibration: Calibration, fit: Fit, intervals: Intervals | None = None) -> list[dict[str, Any]]:
    """Every free parameter as {name, value, nominal, change, unit, sigma, identifiable, plausible} in mm and degrees.

    Base and tool are given as x, y, z and rx, ry, rz of the whole frame (URDF order Rz Ry Rx); their sigmas are those
    of small increments along the frame's own axes. ``intervals`` add lower and upper, a prior of the type from_prior.
    """
    model = calibration.model
    unobservable = unobservable_names(fit.problem.model, fit.problem.measurement.observations)
    known = identifiable(fit.sigma, fit.problem.prior_sigma) & ~np.isin(fit.names, list(unobservable))
    rows = build_parameter_rows(calibration, fit.names, fit.sigma, known)
    if fit.problem.model.of_type is not None:
        rows = [{**row, "from_prior": bool(rests)} for row, rests in zip(rows, resting(fit), strict=True)]
    if intervals is not None:
        ends = zip(rows, intervals.lower, intervals.upper, intervals.stands_in, strict=True)
        for row, below, above, stands_in in ends:
            scale = display_unit_and_scale(model.parameter(row["name"]).unit)[1]
            row["lower"], row["upper"] = row["value"] + float(below) * scale, row["value"] + float(above) * scale
            row["interval_from"] = "sigma" if stands_in else intervals.kind
    return rows


def build_parameter_rows(
    calibration: Calibration, names: Sequence[str], sigma: Floats, known: Bools
) -> list[dict[str, Any]]:
    """One row for each of the parameters ``names``, with its ``sigma (F,)`` SI and whether it is ``known (F,)``."""
    values, nominal = _absolute(calibration), _nominal(calibration)
    rows: list[dict[str, Any]] = []
    for name, spread, seen in zip(names, sigma, known, strict=True):
        parameter = calibration.model.parameter(name)
        unit, scale = display_unit_and_scale(parameter.unit)
        rows.append(
            {
                "name": name,
                "value": values[name] * scale,
                "nominal": nominal[name] * scale,
                "change": _change(name, values[name] - nominal[name]) * scale,
                "unit": unit,
                "sigma": float(spread) * scale,
                "identifiable": bool(seen),
                "plausible": parameter.plausible(values[name]),
            }
        )
    return rows


def _change(name: str, change: float) -> float:
    """What a value differs from nominal; rotations of base and tool by the smaller angle."""
    turns = name in _TURNS
    return math.remainder(change, 2.0 * math.pi) if turns else change


def known_parameters(calibration: Calibration, names: Sequence[str], covariance: Floats, prior_sigma: Floats) -> Known:
    """What is known of the free parameters ``names`` of a calibration, for the sums of :func:`null_rows`."""
    model, every = calibration.model, _absolute(calibration)
    values = np.array([every.get(name, np.nan) for name in names])
    units = [display_unit_and_scale(model.parameter(name).unit) for name in names]
    axes = {frame: T[:3, :3] for frame, T in (("base", model.T_base), ("tool", model.T_tool))}
    return Known(names, values, units, covariance, prior_sigma, axes)


def known_of_fit(calibration: Calibration, fit: Fit) -> Known:
    """The same of all that was free in the fit of a calibration."""
    return known_parameters(calibration, fit.names, fit.covariance, fit.problem.prior_sigma)


def null_rows(directions: Sequence[NullDirection], known: Known) -> list[dict[str, Any]]:
    """Directions that the data cannot tell, in words and by their members, with the sums of members that they do know."""
    rows = []
    for d, sums in zip(directions, known.sums(directions), strict=True):
        rows.append(
            {
                "parameters": [{"name": name, "weight": weight} for name, weight in d.weights],
                "structural": d.structural,
                "sums": sums,
                "sentence": " ".join([d.sentence(), *(one["sentence"] for one in sums)]),
            }
        )
    return rows


def fit_warnings(fit: Fit, train: Observations, repeats: Repeats) -> Iterator[dict[str, Any]]:
    """What a metrologist should know before trusting the result."""
    for j in still_joints(train):
        name = fit.problem.model.robot.joints[j].name
        yield {
            "code": "joint_never_moves",
            "joint": name,
            "message": f"Joint {name} never moves: nothing about it can be identified. Vary it, or fix its parameters.",
        }
    spread = workspace_uncertainty(fit)
    if spread is not None and spread.too_alike:
        yield spread.warning()
    if fit.problem.measurement.observes_base and (train.position is not None or train.markers is not None):
        points = fit.problem.model.predict(fit.problem.batch, fit.values).position
        yield from large_residual(_rms(fit.residual.points), points)
    bent = None if train.markers is None else bending(train.markers, repeats.shots or repeats.between)
    if bent is not None:
        yield {
            "code": "markers_not_rigid",
            "markers": list(bent[:2]),
            "message": f"The distance of markers {bent[0]} and {bent[1]} varies by {mm(bent[2]):.2f} mm (standard "
            "deviation): the set bends, or one of them is loose. Fasten them; until then errors below that mean little.",
        }
    yield from _repeat_warnings(repeats)
    loaded = [e.id for e in fit.problem.model.effects if "moments" in e.needs]
    if loaded and not np.any(fit.problem.batch.wrench):
        yield {
            "code": "no_load",
            "message": f"{', '.join(loaded)} need load moments, but neither link masses nor a payload are known: "
            "give links with mass_kg and com_mm, or payload_kg.",
        }


def _repeat_warnings(repeats: Repeats) -> Iterator[dict[str, Any]]:
    """What repeats of poses say of the noise, and which of them are copies or wrong."""
    if repeats.between is None:
        only = "No pose was repeated"
        if repeats.shots is not None:
            only = "Poses were only shot several times without motion between, which does not show how the arm comes to rest"
        yield {
            "code": "no_repeats",
            "message": f"{only}, so the noise is that of the fit itself, model errors included. "
            "Come back to a few poses to know what cannot be predicted.",
        }
    if len(repeats.copies):
        yield {
            "code": "repeats_identical",
            "rows": (repeats.copies + 1).tolist(),
            "message": f"{len(repeats.copies)} rows measured exactly what an earlier row of their pose did; the first is row "
            f"{repeats.copies[0] + 1} of the rows fitted. Without scatter they are copies, held readings or simulated, and "
            "say nothing of noise. Upload every row once, or measure the poses again.",
        }
    if len(repeats.wrong):
        yield {
            "code": "repeats_differ",
            "rows": (repeats.wrong + 1).tolist(),
            "message": f"{len(repeats.wrong)} rows stand too far from the repeats of their pose to be noise; the first is row "
            f"{repeats.wrong[0] + 1} of the rows fitted. Backlash does that too, and `kilter gap` finds it. Wrong rows: remove "
            "them, or identify with loss tukey, which lets them go.",
        }


def large_residual(rms_m: float, points: Floats) -> Iterator[dict[str, Any]]:
    """Say when much of the error is left, measured against the workspace: what that comes from it does not know."""
    spread = float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))
    if rms_m > LARGE * spread:
        yield {
            "code": "large_residual",
            "message": f"{mm(rms_m):.3g} mm are left over a workspace of {mm(spread):.3g} mm. No swapped, reversed or "
            "otherwise read joints, no unit and no change of tool explain that; the nominal geometry, loads or poor "
            "measurements may. Check the robot's description, and look for what is missing with `kilter gap`.",
        }


def still_joints(observations: Observations) -> list[int]:
    """Joints whose reading never changes."""
    return [int(j) for j in np.flatnonzero(np.ptp(observations.q, axis=0) < STILL_RAD)]


def _rms(points: Floats) -> float:
    """Rms size of errors (N, m, 3), unseen markers left out."""
    return float(np.sqrt(np.nanmean(np.sum(points**2, axis=-1))))


def unobservable_names(model: RobotModel, observations: Observations) -> Iterator[str]:
    """Parameters of the joint elements that never move: their columns alias their neighbours'."""
    still = set(still_joints(observations))
    for e in model.robot.chain.elements:
        if e.joint in still and e.name:
            yield e.name


def _absolute(calibration: Calibration) -> dict[str, float]:
    model = calibration.model
    values = dict(zip(calibration.names, (float(v) for v in calibration.values), strict=True))
    robot = calibration.robot
    return values | _frame("base", model.T_base, robot.T_base) | _frame("tool", model.T_tool, robot.T_tool)


def _nominal(calibration: Calibration) -> dict[str, float]:
    robot = calibration.robot
    values = {p.name: p.value for p in calibration.model.parameters}
    return values | _frame("base", robot.T_base, robot.T_base) | _frame("tool", robot.T_tool, robot.T_tool)


def _frame(which: str, T: Floats, nominal: Floats) -> dict[str, float]:
    """A frame's numbers, of its angles those next to the nominal ones."""
    xyz, rpy = xyz_rpy_from_pose(T, xyz_rpy_from_pose(nominal)[1])
    return dict(zip([f"{which}_{k}" for k in ("x", "y", "z", "rx", "ry", "rz")], map(float, [*xyz, *rpy]), strict=True))
