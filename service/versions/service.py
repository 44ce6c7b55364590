"""What can be done with versions."""

from __future__ import annotations

from collections.abc import Sequence

from service.contract.versions import ActivationList, ParameterChange, Version, VersionDiff, VersionList
from service.db import Database, Session
from service.errors import ServiceError
from service.exporters.exportable import Exportable
from service.exporters.registry import Exported, export
from service.robots import store as robots
from service.versions import store
from service.versions.store import ActiveVersion
from service.versions.values import Value, wire_values


def active_calibrations(session: Session) -> dict[str, ActiveVersion]:
    """Return the active version of every robot that has one, by robot name."""
    found = {name: store.active_version(session, name) for name in store.robots_with_active(session)}
    return {name: version for name, version in found.items() if version is not None}


def listed(database: Database, robot: str, retired: bool = False) -> VersionList:
    """List the versions of a robot; with ``retired`` also those that are out of use."""
    with database.reading() as session:
        return VersionList(versions=store.of_robot(session, robots.get(session, robot).id, retired))


def get(database: Database, version_id: str) -> Version:
    """Return a version."""
    with database.reading() as session:
        return store.get(session, version_id)


def activations(database: Database, robot: str) -> ActivationList:
    """Return who activated which version of a robot, and when."""
    with database.reading() as session:
        return ActivationList(activations=store.activations(session, robots.get(session, robot).id))


def diff(database: Database, a: str, b: str) -> VersionDiff:
    """Compare two versions of one robot.

    Raises:
        ServiceError: they are of different robots.

    """
    with database.reading() as session:
        first, second = store.get(session, a), store.get(session, b)
        if first.robot != second.robot:
            raise ServiceError(
                f"Version {a} is of robot {first.robot!r}, {b} of {second.robot!r}: compare versions of one robot.",
                code="option_invalid",
            )
        values_a, values_b = (wire_values(store.calibration(session, version)) for version in (a, b))
    names = [*values_a, *(name for name in values_b if name not in values_a)]
    return VersionDiff(
        a=a,
        b=b,
        effects_added=[effect for effect in second.effects if effect not in first.effects],
        effects_removed=[effect for effect in first.effects if effect not in second.effects],
        parameters=[_change(name, values_a.get(name), values_b.get(name)) for name in names],
        metrics_a=first.metrics,
        metrics_b=second.metrics,
    )


def _change(name: str, a: Value | None, b: Value | None) -> ParameterChange:
    return ParameterChange(
        name=name,
        unit=(a or b or Value(0.0, "")).unit,
        a=a.value if a else None,
        b=b.value if b else None,
        change=b.value - a.value if a and b else None,
    )


def exported(database: Database, version_id: str, format_name: str) -> Exported:
    """Return a version as a file of another tool's format."""
    with database.reading() as session:
        version = store.get(session, version_id)
        robot = robots.get(session, version.robot)
        document = store.row_of(session, version_id).calibration
    return export(format_name, Exportable(robot, version, document))


def residuals(database: Database, version_id: str, campaigns: Sequence[str], media: str) -> bytes:
    """Return what a version leaves of every row of campaigns, as a file."""
    from service.versions.residuals import residuals as table  # compiled kernels: not at the start of the API process

    return table(database, version_id, campaigns, media)
