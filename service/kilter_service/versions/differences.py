"""How two versions differ, or a version and the nominal robot."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from kilter_service.contract.fits import Metrics
from kilter_service.contract.versions import ParameterChange, VersionDiff
from kilter_service.db import Database, Session
from kilter_service.errors import ServiceError
from kilter_service.versions import store
from kilter_service.versions.values import Value, wire_values
from kilter_service.versions.wire import summary

if TYPE_CHECKING:
    from kilter_core.model import Calibration

NOMINAL = "nominal"


class _Side(NamedTuple):
    """What is compared: effects, values, standard deviations and errors, in the units of the wire."""

    name: str
    robot: str
    effects: list[str]
    values: dict[str, Value]
    sigma: dict[str, float]
    metrics: Metrics


def diff(database: Database, a: str, b: str) -> VersionDiff:
    """Compare two versions of one robot; either may be ``nominal``: the nominal robot with the other's effects at zero.

    Raises:
        ServiceError: they are of different robots, or both are nominal.

    """
    if a == b == NOMINAL:
        raise ServiceError(f"Both are {NOMINAL!r}: name a version to compare with it.", code="option_invalid")
    with database.reading() as session:
        first = None if a == NOMINAL else _of_version(session, a)
        second = None if b == NOMINAL else _of_version(session, b)
        known = first or second
        assert known is not None
        drawn = _Side(NOMINAL, known.robot, [], _drawn(session, b if a == NOMINAL else a), {}, Metrics())
    return _compared(first or drawn, second or drawn)


def _of_version(session: Session, version: str) -> _Side:
    record = store.get(session, version)
    about = summary(record)
    rows = record.report.get("parameters") or []
    sigma = {row["name"]: float(row["sigma"]) for row in rows if row.get("sigma") is not None}
    return _Side(
        version, about.robot, about.effects, wire_values(store.calibration(session, version)), sigma, about.metrics
    )


def _drawn(session: Session, version: str) -> dict[str, Value]:
    """Values of the nominal robot for everything that a version has a number for."""
    calibration: Calibration = store.calibration(session, version)
    robot, model = calibration.robot, calibration.model
    nominal = replace(model, T_base=robot.T_base, T_tool=robot.T_tool)
    return wire_values(replace(calibration, model=nominal, values=model.values0()))


def _compared(a: _Side, b: _Side) -> VersionDiff:
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
    )
