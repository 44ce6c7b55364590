"""How two versions differ, or a version and the nominal robot."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from kilter_core.errors import CoreError
from kilter_core.parameters import display_unit_and_scale
from kilter_service.campaigns import store as campaigns
from kilter_service.contract.fits import Metrics
from kilter_service.contract.versions import ParameterChange, VersionDiff
from kilter_service.ground.called import display_name
from kilter_service.ground.core import transforms
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.versions import store
from kilter_service.versions.predictions.paired import NOTHING, Pairs, Side, judge_pairs, pairs
from kilter_service.versions.wire import summary

if TYPE_CHECKING:
    from kilter_core.model import Calibration

FRAME = (("x", "mm"), ("y", "mm"), ("z", "mm"), ("rx", "deg"), ("ry", "deg"), ("rz", "deg"))


class Value(NamedTuple):
    """A number and its unit."""

    value: float
    unit: str


def wire_values(calibration: Calibration) -> dict[str, Value]:
    """Return every parameter by name; base and tool as x, y, z and rx, ry, rz (URDF) next to the nominal ones."""
    model, values = calibration.model.absorb_frame_increments(calibration.values)
    out = {}
    for parameter, value in zip(model.parameters, values, strict=True):
        unit, scale = display_unit_and_scale(parameter.unit)
        out[parameter.name] = Value(float(value) * scale, unit)
    robot = calibration.robot
    for which, T, nominal in (("base", model.T_base, robot.T_base), ("tool", model.T_tool, robot.T_tool)):
        near = transforms.xyz_rpy_from_pose(np.asarray(nominal))[1]
        xyz, rpy = transforms.xyz_rpy_from_pose(np.asarray(T), near)
        numbers = [*(xyz * 1e3), *np.degrees(rpy)]
        out |= {f"{which}_{k}": Value(float(v), unit) for (k, unit), v in zip(FRAME, numbers, strict=True)}
    return out


NOMINAL = "nominal"
MOST_CAMPAIGNS = 20  # whose rows are compared without asking
ROUNDING = 1e-9  # smaller changes are none
SURE = 1.96  # standard deviations: 95 %
NO_BASE = "The nominal robot has no base to be compared in: rows are compared between two versions."
UNMEASURED = "This robot has no measurements to compare on."


class _Side(NamedTuple):
    """What is compared: effects, values, standard deviations and errors, in the units of the wire."""

    name: str
    robot: str
    effects: list[str]
    values: dict[str, Value]
    sigma: dict[str, float]
    metrics: Metrics
    called: str = ""


@dataclass(frozen=True)
class Compared:
    """How two versions differ, the campaigns on whose rows, and these rows paired; none where it cannot be said."""

    diff: VersionDiff
    campaigns: Sequence[str]
    pairs: Pairs | None


def diff(database: Database, a: str, b: str, wanted: Sequence[str] = ()) -> VersionDiff:
    """Compare two versions of one robot; either may be ``nominal``: the nominal robot with the other's effects at zero.

    A job stands for the version that it made. Rows are those of the campaigns ``wanted``, by default of all that either
    version was made from, else of the newest campaign.

    Raises:
        ServiceError: they are of different robots, or both are nominal.

    """
    return compare_versions(database, a, b, wanted).diff


def compare_versions(
    database: Database, a: str, b: str, wanted: Sequence[str] = (), few: Callable[[Sequence[str]], bool] | None = None
) -> Compared:
    """Compare two versions as ``diff`` does, and keep the rows.

    Where ``few`` says no of the campaigns, rows are left alone: neither ``paired`` nor ``not_paired`` is said.
    """
    a, b = resolve_version_id(a), resolve_version_id(b)
    if a == b == NOMINAL:
        raise ServiceError(f"Both are {NOMINAL!r}: name a version to compare with it.", code="option_invalid")
    with database.reading() as session:
        first = None if a == NOMINAL else _of_version(session, a)
        second = None if b == NOMINAL else _of_version(session, b)
        known = first or second
        assert known is not None
        drawn = _Side(NOMINAL, known.robot, [], _drawn(session, b if a == NOMINAL else a), {}, Metrics())
        found = _diff_sides(first or drawn, second or drawn)
        chosen = list(wanted) or _usual(session, [one for one in (a, b) if one != NOMINAL])
    if first is None or second is None:
        return Compared(found.model_copy(update={"not_paired": NO_BASE}), chosen, None)
    if not chosen:
        return Compared(found.model_copy(update={"not_paired": UNMEASURED}), chosen, None)
    if few is not None and not few(chosen):
        return Compared(found, chosen, None)
    try:
        rows = pairs(database, a, b, chosen)
        said = judge_pairs(database, rows, *(Side(one.name, one.called or one.name) for one in (first, second)))
    except CoreError as error:
        return Compared(found.model_copy(update={"not_paired": error.message}), chosen, None)
    if said is None:
        return Compared(found.model_copy(update={"not_paired": NOTHING}), chosen, None)
    return Compared(found.model_copy(update={"paired": said}), chosen, rows)


def resolve_version_id(name: str) -> str:
    """Return the version that a job made, for its id; any other name as it is."""
    return f"ver_{name.removeprefix('job_')}" if name.startswith("job_") else name


def _usual(session: Session, versions: Sequence[str]) -> list[str]:
    """Campaigns that either version was made from, else the newest of the robot."""
    rows = [store.get(session, one) for one in versions]
    used = list(dict.fromkeys(part["id"] for row in rows for part in row.campaigns))
    there = [
        one for one in campaigns.ids_of_robot(session, rows[0].robot_id) if campaigns.uploads_of_campaign(session, one)
    ]
    known = [one for one in used if one in there][:MOST_CAMPAIGNS]
    return known or there[-1:]


def _of_version(session: Session, version: str) -> _Side:
    record = store.get(session, version)
    about = summary(record)
    rows = record.report.get("parameters") or []
    sigma = {row["name"]: float(row["sigma"]) for row in rows if row.get("sigma") is not None}
    return _Side(
        version,
        about.robot,
        about.effects,
        wire_values(store.calibration(session, version)),
        sigma,
        about.metrics,
        display_name(about),
    )


def _drawn(session: Session, version: str) -> dict[str, Value]:
    """Values of the nominal robot for everything that a version has a number for."""
    calibration: Calibration = store.calibration(session, version)
    robot, model = calibration.robot, calibration.model
    nominal = replace(model, T_base=robot.T_base, T_tool=robot.T_tool)
    return wire_values(replace(calibration, model=nominal, values=model.values0()))


def _diff_sides(a: _Side, b: _Side) -> VersionDiff:
    if a.robot != b.robot:
        raise ServiceError(
            f"Version {a.name} is of robot {a.robot!r}, {b.name} of {b.robot!r}: compare versions of one robot.",
            code="option_invalid",
        )
    names = [*a.values, *(name for name in b.values if name not in a.values)]
    return VersionDiff(
        a=a.name,
        b=b.name,
        effects_added=[effect for effect in b.effects if effect not in a.effects],
        effects_removed=[effect for effect in a.effects if effect not in b.effects],
        parameters=[_change(name, a, b) for name in names],
        metrics_a=a.metrics,
        metrics_b=b.metrics,
    )


def _change(name: str, a: _Side, b: _Side) -> ParameterChange:
    before, after = a.values.get(name), b.values.get(name)
    return ParameterChange(
        name=name,
        unit=(before or after or Value(0.0, "")).unit,
        a=before.value if before else None,
        b=after.value if after else None,
        change=after.value - before.value if before and after else None,
        sigma_a=a.sigma.get(name),
        sigma_b=b.sigma.get(name),
        moved=before is None
        or after is None
        or _beyond(after.value - before.value, a.sigma.get(name), b.sigma.get(name)),
    )


def _beyond(change: float, sigma_a: float | None, sigma_b: float | None) -> bool:
    """Whether a parameter moved by more than chance explains, the errors of both taken as independent."""
    return abs(change) > max(SURE * math.hypot(sigma_a or 0.0, sigma_b or 0.0), ROUNDING)
