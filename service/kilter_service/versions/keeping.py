"""Names and notes of versions; retiring, restoring and purging them."""

from __future__ import annotations

from kilter_service.contract.references import Change, Tombstone
from kilter_service.contract.versions import Version
from kilter_service.ground.db import Database
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.references import store as references
from kilter_service.ground.references.store import TombstoneRecord, tombstone
from kilter_service.versions import store, wire
from kilter_service.versions.records import VersionRecord


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
        left = TombstoneRecord(version.id, "version", version.robot, version.name, version.sha256, actor, utc_now())
        references.add_tombstone(session, left)
        store.remove(session, version_id)
    return tombstone(left)


def _refuse_active(version: VersionRecord, what: str) -> None:
    if version.active:
        raise ServiceError(
            f"Robot {version.robot!r} is corrected with version {version.id}, so it cannot be {what}: activate another "
            "one first.",
            code="version_active",
            version=version.id,
            robot=version.robot,
        )
