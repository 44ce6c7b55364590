"""What can be done with versions."""

from __future__ import annotations

from dataclasses import replace

from kilter_service.campaigns import store as campaigns
from kilter_service.contract.versions import ActivationList, Version, VersionList, VersionSummary
from kilter_service.contract.wording import Change, Tombstone
from kilter_service.ground import store as references
from kilter_service.ground.caller import allowed_robots
from kilter_service.ground.db import Database
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import copy_fields
from kilter_service.ground.paging import Page, in_time
from kilter_service.robots import store as robots
from kilter_service.robots.compensation import said_of_controller
from kilter_service.robots.exporters.exportable import Exportable
from kilter_service.robots.exporters.registry import RANGES, Exported, export, export_notes
from kilter_service.versions import store, wire
from kilter_service.versions.records import VersionRecord


def list_versions(database: Database, robot: str, page: Page, with_retired: bool = False) -> VersionList:
    """List the versions of a robot; ``with_retired`` those that are out of use too."""
    with database.reading() as session:
        found = store.list_versions(session, robots.get(session, robot).id, page, with_retired)
    shown, cursor = page.cut(found, lambda version: in_time(version.created_at, version.id))
    return VersionList(versions=list(shown), next=cursor)


def active_of_robots(database: Database) -> dict[str, VersionSummary]:
    """Return the versions that robots are corrected with, by robot."""
    with database.reading() as session:
        return {found.robot: wire.summary(found) for found in store.active_of_robots(session)}


def get(database: Database, version_id: str) -> Version:
    """Return a version."""
    with database.reading() as session:
        return wire.version(store.get(session, version_id))


def versions_from_campaign(database: Database, campaign_id: str) -> list[Version]:
    """Return the versions that were made with a campaign, newest first."""
    with database.reading() as session:
        campaign = campaigns.get(session, campaign_id)
        found = [store.get(session, one) for one in references.citing_campaign(session, campaign.robot_id, campaign_id)]
    return [wire.version(one) for one in sorted(found, key=lambda one: one.created_at, reverse=True)]


def activations(database: Database, robot: str, page: Page) -> ActivationList:
    """Return who activated which version of a robot, and when."""
    with database.reading() as session:
        found = store.activations(session, robots.get(session, robot).id, page)
    shown, cursor = page.cut(found, lambda entry: (str(entry.id),))
    return ActivationList(activations=[wire.activation(entry) for entry in shown], next=cursor)


def export_version(database: Database, version_id: str, format_name: str, ranges_percent: float = 95.0) -> Exported:
    """Return a version as a file of another tool's format, and what to say of a controller that is given it."""
    version, told = _exportable(database, version_id, format_name)
    version = replace(version, ranges_percent=ranges_percent)
    found = export(format_name, version)
    return found._replace(notes=(*found.notes, *told))


def exported_notes(database: Database, version_id: str, format_name: str) -> tuple[str, ...]:
    """Return what a version's file of a format leaves out, and what to say of a controller that is given it."""
    version, told = _exportable(database, version_id, format_name)
    return (*export_notes(format_name, version), *told)


def _exportable(database: Database, version_id: str, format_name: str) -> tuple[Exportable, tuple[str, ...]]:
    with database.reading() as session:
        record = store.get(session, version_id)
        robot, rules = robots.get(session, record.robot), store.activation_rules(session, version_id)
        fleet = store.fleet_versions(session, robot.id, allowed_robots()) if format_name == RANGES else ()
    version = Exportable(robot, wire.version(record), record.calibration, rules, fleet=fleet)
    return version, said_of_controller(format_name, robot.name, robot.controller_compensation)


def change(database: Database, version_id: str, wanted: Change) -> Version:
    """Name a version (an empty name takes it away), or note something on it; what it holds stays.

    Raises:
        ServiceError: no such version, or a name that is taken or invalid.

    """
    with database.transaction() as session:
        version = store.get(session, version_id)
        if wanted.name is not None and wanted.name != version.name:
            references.check_name(session, "version", version.robot_id, wanted.name, version.id)
        references.change(session, "version", version_id, wanted.name, wanted.notes)
        return wire.version(store.get(session, version_id))


def retire(database: Database, version_id: str, actor: str) -> Version:
    """Take a version out of use: no list shows it, no job starts from it, it cannot be activated.

    Raises:
        ServiceError: no such version, or the robot is corrected with it.

    """
    with database.transaction() as session:
        _refuse_active(store.get(session, version_id), "retired")
        references.retire(session, "version", version_id, actor)
        return wire.version(store.get(session, version_id))


def restore(database: Database, version_id: str) -> Version:
    """Bring a version back into use.

    Raises:
        ServiceError: no such version, or another has its name now.

    """
    with database.transaction() as session:
        references.restore(session, "version", store.get(session, version_id).id)
        return wire.version(store.get(session, version_id))


def purge(database: Database, version_id: str, actor: str) -> Tombstone:
    """Delete a version; its hash is kept.

    Raises:
        ServiceError: no such version, or another version, the log of activations or a job that is not over cites it.

    """
    with database.transaction() as session:
        version = store.get(session, version_id)
        _refuse_active(version, "purged")
        citing = store.citing_version(session, version.robot_id, version.id)
        references.refuse_cited("version", version.id, citing, "purge what can be purged first")
        left = copy_fields(Tombstone, version, kind="version", by=actor, at=utc_now())
        references.add_tombstone(session, left)
        store.remove(session, version_id)
    return left


def _refuse_active(version: VersionRecord, what: str) -> None:
    if version.active:
        raise ServiceError(
            f"Robot {version.robot!r} is corrected with version {version.id}, so it cannot be {what}: activate another "
            "one first.",
            code="version_active",
            version=version.id,
            robot=version.robot,
        )
