"""The whole database as rows: checked by their hashes, and copied table by table.

When something was stored last.
"""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from typing import Any

from sqlalchemy import Connection, Select, Table, delete, func, insert, literal, select, text
from sqlalchemy.exc import DBAPIError

from kilter_service.ground.caller import on_behalf
from kilter_service.ground.db import Database, Session, initial_seals
from kilter_service.ground.db.audited import MOST_CHANGES, audit_differences, note
from kilter_service.ground.db.database_seal import read_database_seal
from kilter_service.ground.db.initial_seals import anew
from kilter_service.ground.db.revision import schema_altered
from kilter_service.ground.db.row import Row
from kilter_service.ground.db.sealed import in_parts
from kilter_service.ground.db.seals import DatabaseSealRow, Sealer, SealRow
from kilter_service.ground.db.tables import (
    ActivationRow,
    CampaignRow,
    ChunkRow,
    JobRow,
    MeshRow,
    RobotRow,
    UploadRow,
    VersionRow,
)
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import plural
from kilter_service.robots.documents import hash_canonical_json, source_sha256
from kilter_service.web.audit import verify_entries
from kilter_service.web.store import everything


@dataclass
class Findings:
    """Sentences about what is damaged or missing, and how much was looked at."""

    damaged: list[str] = field(default_factory=list)
    robots: int = 0
    campaigns: int = 0
    chunks: int = 0
    versions: int = 0
    meshes: int = 0
    every_row: bool = False  # all tables were compared with a backup's manifest, or one was written
    sealed: bool = True  # else it is of a release that sealed no rows
    revision: str | None = None  # of a copy, before it was brought to this one
    other_key: str = ""  # why no seal can be compared: it is sealed with another key than the one in use

    def add(self, sentence: str) -> None:
        """Note one more."""
        self.damaged.append(sentence)

    @property
    def sentences(self) -> list[str]:
        """All that keeps it from being whole."""
        return [*filter(None, [self.other_key]), *self.damaged]

    def headline(self) -> str:
        """Say that it is whole; of what has no seals, no more than what was compared."""
        if self.sealed:
            return f"All is whole: {self.describe_coverage()}; {self.describe_hash_check()}."
        hashes = f"Hashes of rows, chunks and versions fit: {self.describe_coverage()}."
        return f"{hashes} It is of a release without seals, so no seal was compared."

    def describe_coverage(self) -> str:
        """Say how much was looked at."""
        campaigns = f"{plural(self.campaigns, 'campaign')} with {plural(self.chunks, 'chunk')}"
        meshes = [plural(self.meshes, "link shape")] if self.meshes else []
        return ", ".join([plural(self.robots, "robot"), campaigns, plural(self.versions, "version"), *meshes])

    def describe_hash_check(self) -> str:
        """Say which of it was checked by a hash."""
        if self.every_row:
            return "every row of every table has its hash"
        return "every row fits its seal, the audit its chain"


AT_ONCE = 50  # rows that are in memory while a table is copied
SAMPLE = 50  # chunks of a quick check, the newest
SEALS = (SealRow.__table__, DatabaseSealRow.__table__)  # an empty database has those of its empty tables
Part = Callable[[Session, Findings, bool], None]


def check(database: Database, *, quick: bool = False) -> Findings:
    """Compare everything stored with its seals and hashes; a quick check looks at the newest chunks only.

    Each part has a snapshot of its own: what a damaged page holds cannot be read, what lies on others can.
    """
    found = Findings()
    _check_part(database, found, "seals", partial(_whole, database), quick)
    if not found.other_key:
        for name in initial_seals.tables(quick=quick):
            _check_part(database, found, f"rows of {name}", partial(_check_table_seals, database, name), quick)
    for part, what in (
        (_schema, "tables and triggers"),
        (_pages, "pages"),
        (_audit, "entries of the audit"),
        (_audited, "rows of the audit"),
        (_robots, "robots"),
        (_chunks, "chunks of campaigns"),
        (_versions, "versions"),
        (_meshes, "shapes of links"),
    ):
        _check_part(database, found, what, part, quick)
    return found


def _check_part(database: Database, found: Findings, what: str, part: Part, quick: bool) -> None:
    try:
        with database.reading() as session:
            part(session, found, quick)
    except DBAPIError as error:
        found.add(f"Not all {what} can be read: {error.orig}.")
    except sqlite3.DatabaseError as error:
        found.add(f"Not all {what} can be read: {error}.")
    except (
        ValueError,
        TypeError,
        KeyError,
        AttributeError,
    ) as error:  # JSON that is no longer JSON, or of another shape
        found.add(f"Not all {what} can be read, what one holds is damaged: {error}.")


def _check_table_seals(database: Database, name: str, session: Session, found: Findings, _quick: bool) -> None:
    """The rows of a table"""
    found.damaged.extend(initial_seals.describe_altered_rows(session.connection(), database.sealer, name))


def _whole(database: Database, session: Session, found: Findings, _quick: bool) -> None:
    """The seal over all tables and the end of the audit"""
    connection = session.connection()
    found.other_key = initial_seals.other_key(connection, database.sealer)
    if not found.other_key:
        found.damaged.extend(initial_seals.whole_altered(connection, database.sealer))


def _schema(session: Session, found: Findings, _quick: bool) -> None:
    """Tables, indexes and triggers"""
    found.damaged.extend(schema_altered(session.connection()))


def _audit(session: Session, found: Findings, _quick: bool) -> None:
    """The audit"""
    try:
        verify_entries(everything(session))
    except ServiceError as error:
        found.add(error.message)


def _pages(session: Session, found: Findings, quick: bool) -> None:
    """The pages of the database"""
    if session.get_bind().dialect.name != "sqlite":
        return
    said = session.execute(text(f"PRAGMA {'quick_check' if quick else 'integrity_check'}(20)")).scalars().all()
    for line in [line for line in said if line != "ok"]:
        found.add(f"The database file is damaged: {line}.")
    for table, row, parent, _ in session.execute(text("PRAGMA foreign_key_check")):
        found.add(f"Row {row} of {table} refers to a row of {parent} that is missing.")


def _audited(session: Session, found: Findings, _quick: bool) -> None:
    """Tokens, activations and repairs, as the audit has them"""
    found.damaged.extend(one.sentence for one in audit_differences(session))


def _robots(session: Session, found: Findings, _quick: bool) -> None:
    """The robots"""
    for row in session.execute(select(RobotRow).order_by(RobotRow.id)).scalars():
        found.robots += 1
        if row.chain is not None and hash_canonical_json(row.chain) != row.sha256:
            found.add(f"Robot {row.name!r}: its chain does not have its hash {row.sha256[:12]}.")
        if row.source_sha256 and source_sha256(row.document) != row.source_sha256:
            found.add(f"Robot {row.name!r}: the document it was posted as does not have its hash.")


def _chunks(session: Session, found: Findings, quick: bool) -> None:
    """The chunks of the campaigns"""
    found.campaigns = session.execute(select(func.count()).select_from(CampaignRow)).scalar_one()
    query = select(UploadRow, CampaignRow.name, RobotRow.name).join(
        CampaignRow, CampaignRow.id == UploadRow.campaign_id
    )
    query = query.join(RobotRow, RobotRow.id == CampaignRow.robot_id).order_by(UploadRow.id.desc())
    for upload, campaign, robot in session.execute(query).all():
        place = f"Campaign {upload.campaign_id} ({campaign!r} of {robot!r}), upload {upload.sha256[:12]}"
        _check_upload(session, found, upload, place)
        if quick and found.chunks >= SAMPLE:
            return


def _check_upload(session: Session, found: Findings, upload: UploadRow, place: str) -> None:
    listed = select(ChunkRow.number, ChunkRow.rows, ChunkRow.sha256).where(ChunkRow.upload_id == upload.id)
    rows = 0
    numbers = []
    for number, count, sha256 in session.execute(listed.order_by(ChunkRow.number)).all():
        found.chunks += 1
        rows += count
        numbers.append(number)
        blob = select(ChunkRow.parquet).where(ChunkRow.upload_id == upload.id, ChunkRow.number == number)
        if not _has_hash(session, blob, sha256):
            found.add(f"{place}: chunk {number} is damaged, its bytes do not have the hash {sha256[:12]}.")
    missing = sorted(set(range(max(numbers, default=0) + 1)) - set(numbers))
    if missing:
        found.add(f"{place}: chunk {', '.join(map(str, missing))} is missing.")
    elif rows != upload.rows:
        found.add(f"{place}: {rows} of {upload.rows} rows are there, the last chunk is missing.")


def _has_hash(session: Session, query: Select[bytes], sha256: str) -> bool:
    try:
        blob = session.execute(query).scalar_one()
    except DBAPIError:  # on a damaged page
        return False
    return hashlib.sha256(blob).hexdigest() == sha256


def _versions(session: Session, found: Findings, _quick: bool) -> None:
    """The versions"""
    uploads = {
        (campaign, sha256) for campaign, sha256 in session.execute(select(UploadRow.campaign_id, UploadRow.sha256))
    }
    for row in session.execute(select(VersionRow).order_by(VersionRow.created_at)).scalars():
        found.versions += 1
        content: dict[str, Any] = {"calibration": row.calibration, "limits": row.limits}
        if row.hash_scheme > 1:
            content["robot"] = row.robot_sha256
        if hash_canonical_json(content) != row.sha256:
            found.add(f"Version {row.id}: its content does not have its hash {row.sha256[:12]}.")
        for used in row.campaigns:
            if gone := [sha256 for sha256 in used["sha256"] if (used["id"], sha256) not in uploads]:
                found.add(
                    f"Version {row.id}: upload {gone[0][:12]} of campaign {used['id']} it was made from is missing."
                )


def _meshes(session: Session, found: Findings, _quick: bool) -> None:
    """The shapes of links"""
    listed = select(RobotRow.id, RobotRow.name, MeshRow.link, MeshRow.sha256).join(
        RobotRow, RobotRow.id == MeshRow.robot_id
    )
    for robot_id, robot, link, sha256 in session.execute(listed.order_by(RobotRow.id, MeshRow.link)).all():
        found.meshes += 1
        if not _has_hash(session, select(MeshRow.content).filter_by(robot_id=robot_id, link=link), sha256):
            found.add(
                f"Robot {robot!r}: the shape of link {link!r} is damaged, its bytes do not have the hash {sha256[:12]}."
            )


def seal(database: Database, *, accept: bool) -> list[str]:
    """Seal all rows anew, with the key of this process, if they are what was stored; else return what is not.

    ``accept`` takes them as they are. An entry of the audit says that it was done.
    """
    with database.reading() as session:
        differences = list(audit_differences(session))
    with database.engine.begin() as connection:
        whole = read_database_seal(connection, database.sealer)
        before = "" if whole is None else whole.keyed_by
        other = initial_seals.other_key(connection, database.sealer)
        found = [other] if other else []
        if not before or not other:
            old = Sealer() if other else database.sealer
            found += initial_seals.whole_altered(connection, old)
            found += [
                one
                for name in initial_seals.tables()
                for one in initial_seals.describe_altered_rows(connection, old, name)
            ]
        found += [one.sentence for one in differences]
        if found and not accept:
            return found
        anew(connection, database.sealer)
    now = f"{database.sealer.number or 'no key'}, {len(found)} findings accepted"
    with on_behalf({"actor": "kilterd", "role": "admin"}, "kilterd seal", {}), database.transaction() as session:
        note(session, "seals", before or "no key", now)
    for some in in_parts(differences, MOST_CHANGES):  # from now on the audit says of them what they are
        with on_behalf({"actor": "kilterd", "role": "admin"}, "kilterd seal", {}), database.transaction() as session:
            for one in some:
                note(session, one.thing, one.audited, one.stored)
    return []


def has_rows(database: Database) -> bool:
    """Whether anything is stored in a database, tables apart."""
    with database.reading() as session:
        return any(
            session.execute(select(func.count()).select_from(t)).scalar_one()
            for t in Row.metadata.sorted_tables
            if t not in SEALS
        )


def copy(source: Database, target: Database) -> int:
    """Copy all rows of one snapshot into a database that has the tables and no rows; returns how many."""
    count = 0
    with source.reading() as session, target.engine.begin() as into:
        for table in Row.metadata.sorted_tables:
            if table in SEALS:
                into.execute(delete(table))
            for rows in _rows(session, table):
                into.execute(insert(table), rows)
                count += len(rows)
        _go_on_numbering(into)
    return count


def _rows(session: Session, table: Table) -> Iterator[list[dict[str, object]]]:
    query = select(table)
    if "parent_id" in table.c:  # a version comes after the one that it continues, whatever the clock said
        first = select(table.c.id, literal(0).label("depth")).where(table.c.parent_id.is_(None)).cte(recursive=True)
        depths = first.union_all(select(table.c.id, first.c.depth + 1).where(table.c.parent_id == first.c.id))
        query = query.join(depths, depths.c.id == table.c.id).order_by(depths.c.depth)
    query = query.order_by(*table.primary_key.columns).execution_options(yield_per=AT_ONCE)
    with session.execute(query) as rows:
        for part in rows.partitions():
            yield [dict(row._mapping) for row in part]


def _go_on_numbering(connection: Connection) -> None:
    """Let PostgreSQL number new rows after those that were copied."""
    if connection.dialect.name != "postgresql":
        return
    for table in Row.metadata.sorted_tables:
        column = table.autoincrement_column
        if column is None:
            continue
        last = connection.execute(select(func.max(column))).scalar_one()
        if last is not None:
            name = {"t": table.name, "c": column.name, "last": last}
            connection.execute(text("SELECT setval(pg_get_serial_sequence(:t, :c), :last)"), name)


def latest_stored_time(database: Database) -> datetime | None:
    """Return the latest time that something says it was stored at."""
    columns = (RobotRow.created_at, CampaignRow.created_at, JobRow.created_at, VersionRow.created_at, ActivationRow.at)
    with database.reading() as session:
        found = [session.execute(select(func.max(column))).scalar_one() for column in columns]
    return max((moment for moment in found if moment is not None), default=None)
