"""What people call versions and note on them; versions out of use, and gone."""

from __future__ import annotations

from service.contract.references import Change, Tombstone
from service.contract.versions import Version
from service.db import Database, Session
from service.db.tables import VersionRow, now
from service.errors import ServiceError
from service.references import retired
from service.references import store as references
from service.robots import store as robots
from service.versions import store


def change(database: Database, version_id: str, wanted: Change) -> Version:
    """Name a version (an empty name takes it away), or note something on it; what it holds stays.

    Raises:
        ServiceError: no such version, or a name that is taken or cannot be.

    """
    with database.transaction() as session:
        row = store.row_of(session, version_id)
        if wanted.name is not None and wanted.name != row.name:
            references.check_name(session, "version", row.robot_id, wanted.name, row.id)
            row.name = wanted.name
        if wanted.notes is not None:
            row.notes = wanted.notes
        session.flush()
        return store.get(session, version_id)


def retire(database: Database, version_id: str, actor: str) -> Version:
    """Take a version out of use: no list shows it, no job starts from it, it cannot be activated.

    Raises:
        ServiceError: no such version, or the robot is corrected with it.

    """
    with database.transaction() as session:
        row = store.row_of(session, version_id)
        _refuse_active(session, row, "retired")
        retired.retire(row, actor)
        session.flush()
        return store.get(session, version_id)


def restore(database: Database, version_id: str) -> Version:
    """Bring a version back into use.

    Raises:
        ServiceError: no such version, or another has its name now.

    """
    with database.transaction() as session:
        row = store.row_of(session, version_id)
        if row.retired_at is not None:
            references.check_name(session, "version", row.robot_id, row.name, row.id)
            retired.restore(row)
        session.flush()
        return store.get(session, version_id)


def purge(database: Database, version_id: str, actor: str) -> Tombstone:
    """Delete a version; its hash is kept.

    Raises:
        ServiceError: no such version, or another version, the log of activations or a job that is not over cites it.

    """
    with database.transaction() as session:
        row = store.row_of(session, version_id)
        _refuse_active(session, row, "purged")
        citing = store.citing_version(session, row.robot_id, row.id)
        if citing:
            raise ServiceError(
                f"Version {row.id} is cited by {', '.join(citing[:10])}{' and more' if len(citing) > 10 else ''}: purge "
                f"what can be purged first, or retire it instead (kilter versions retire {row.id}).",
                code="cited",
                version=row.id,
                cited_by=citing,
            )
        robot = robots.by_id(session, row.robot_id).name
        tombstone = Tombstone(
            id=row.id, kind="version", robot=robot, name=row.name, sha256=row.sha256, by=actor, at=now()
        )  # fmt: skip
        references.bury(session, tombstone)
        session.delete(row)
    return tombstone


def _refuse_active(session: Session, row: VersionRow, what: str) -> None:
    last = store.active_row(session, row.robot_id)
    if last is not None and last.version_id == row.id:
        robot = robots.by_id(session, row.robot_id).name
        raise ServiceError(
            f"Robot {robot!r} is corrected with version {row.id}, so it cannot be {what}: activate another one first.",
            code="version_active",
            version=row.id,
            robot=robot,
        )
