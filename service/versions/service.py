"""What can be done with versions."""

from __future__ import annotations

from service.db import Database, Session
from service.errors import ServiceError
from service.exporters.exportable import Exportable
from service.exporters.registry import Exported, export
from service.robots import store as robots
from service.versions import store
from service.versions.schemas import (
    ActivatedVersion,
    ActivationList,
    ParameterChange,
    Version,
    VersionDiff,
    VersionList,
    VersionSummary,
)
from service.versions.store import ActiveVersion
from service.versions.values import Value, wire_values

ACTIVATE, ROLLBACK = "activate", "rollback"


def active_calibrations(session: Session) -> dict[str, ActiveVersion]:
    """Return the active version of every robot that has one, by robot name."""
    found = {name: store.active_version(session, name) for name in store.robots_with_active(session)}
    return {name: version for name, version in found.items() if version is not None}


def listed(database: Database, robot: str) -> VersionList:
    """List the versions of a robot."""
    with database.transaction() as session:
        return VersionList(versions=store.of_robot(session, robots.get(session, robot).id))


def get(database: Database, version_id: str) -> Version:
    """Return a version."""
    with database.transaction() as session:
        return store.get(session, version_id)


def activate(database: Database, version_id: str, actor: str, temperature_c: float | None = None) -> ActivatedVersion:
    """Make a version the one its robot is corrected with; the active one again changes nothing.

    ``temperature_c`` is that of the arm as the corrector knows it: without it thermal growth stays uncorrected.
    """
    left_out = _left_out(database, version_id, temperature_c)  # first: what cannot be corrected is not activated
    with database.transaction() as session:
        row = store.row_of(session, version_id)
        last = store.active_row(session, row.robot_id)
        if last is None or last.version_id != version_id:
            store.activate(session, row.robot_id, version_id, ACTIVATE, actor)
        return _activated(session, version_id, left_out)


def _left_out(database: Database, version_id: str, temperature_c: float | None) -> list[str]:
    """Effects of a version that setpoints are not corrected for."""
    from core.correction import CorrectionOptions, compile_program  # compiled kernels: not at the start of the API

    with database.transaction() as session:
        calibration = store.calibration(session, version_id)
    return list(compile_program(calibration, CorrectionOptions(temperature_c=temperature_c)).unsupported)


def _activated(session: Session, version_id: str, left_out: list[str]) -> ActivatedVersion:
    found = store.get(session, version_id).model_dump(include=set(VersionSummary.model_fields))
    return ActivatedVersion(**found, unsupported_effects=left_out)


def rollback(database: Database, robot: str, actor: str, temperature_c: float | None = None) -> ActivatedVersion:
    """Return to the version that was active before the present one; again, to the one before that.

    Raises:
        ServiceError: there is no earlier one.

    """
    with database.transaction() as session:
        robot_id = robots.get(session, robot).id
        before = _before(session, robot_id)
        if before is None:
            raise ServiceError(
                f"Robot {robot!r} has no earlier active version: activate one with POST /v1/versions/{{id}}/activate.",
                code="nothing_to_roll_back",
                robot=robot,
            )
        store.activate(session, robot_id, before, ROLLBACK, actor)
    left_out = _left_out(database, before, temperature_c)
    with database.transaction() as session:
        return _activated(session, before, left_out)


def _before(session: Session, robot_id: int) -> str | None:
    stack: list[str] = []
    for entry in reversed(store.activations(session, robot_id)):
        if entry.action == ROLLBACK:
            stack.pop()
        else:
            stack.append(entry.version_id)
    return stack[-2] if len(stack) > 1 else None


def activations(database: Database, robot: str) -> ActivationList:
    """Return who activated which version of a robot, and when."""
    with database.transaction() as session:
        return ActivationList(activations=store.activations(session, robots.get(session, robot).id))


def diff(database: Database, a: str, b: str) -> VersionDiff:
    """Compare two versions of one robot.

    Raises:
        ServiceError: they are of different robots.

    """
    with database.transaction() as session:
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
    with database.transaction() as session:
        version = store.get(session, version_id)
        robot = robots.get(session, version.robot)
        document = store.row_of(session, version_id).calibration
    return export(format_name, Exportable(robot.document, version, document))
