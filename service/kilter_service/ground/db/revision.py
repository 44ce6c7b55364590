"""The revision that the database has, the one that this code needs, and the migration between them.

Whether tables, columns, indexes and triggers are those of the revision: a trigger that is gone lets the audit be changed.

What the revision has is in schema.json, as each database describes it; a test compares it with the migrations.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from sqlalchemy import Connection, bindparam, inspect, text
from sqlalchemy.exc import DBAPIError

from kilter_service.ground.db.database import Database, DatabaseAwayError
from kilter_service.ground.db.database_seal import check_key
from kilter_service.ground.db.failures import in_words
from kilter_service.ground.db.row import Row
from kilter_service.ground.db.seals import SealRow
from kilter_service.ground.errors import ServiceError

if TYPE_CHECKING:
    from alembic.config import Config


REVISION = re.compile(r'^revision = "(\w+)"', re.MULTILINE)
PACKAGE = Path(__file__).resolve().parents[2]


def migrations() -> Path:
    """Return the folder of the revisions: inside an installed package, beside the folder of the sources else."""
    installed = PACKAGE / "migrations"
    return installed if installed.is_dir() else PACKAGE.parents[1] / "migrations"


# The newest file of migrations/versions. Written down because importing alembic costs a second at every start;
# a test compares it with what alembic finds.
HEAD = "0025"


def current(database: Database) -> str | None:
    """Return the revision the database has; None when it has no tables yet."""
    with database.reading() as session:
        connection = session.connection()
        if not inspect(connection).has_table("alembic_version"):
            return None
        found: list[str] = list(connection.execute(text("SELECT version_num FROM alembic_version")).scalars())
    if len(found) > 1:
        raise _altered_error(f"The database names {len(found)} revisions ({', '.join(map(str, found))[:100]})")
    return found[0] if found else None


def _altered_error(what: str) -> ServiceError:
    said = f"{what}: it was altered past Kilter. Nothing was changed. Bring back a backup with `kilterd restore`."
    return ServiceError(said, code="database_damaged")


def check(database: Database) -> None:
    """Refuse to work on a database of another revision, naming the command that fixes it."""
    found = current(database)
    if found == HEAD:
        with database.reading() as session:
            check_key(session, database.sealer)
        return
    _refuse_newer(found)
    raise ServiceError(
        f"The database is at revision {found or 'none'}, this Kilter needs {HEAD}: run `kilterd migrate` "
        "(`kilterd serve` does it by itself).",
        code="database_outdated",
        revision=found,
        needed=HEAD,
    )


def _refuse_newer(found: str | None) -> None:
    """Refuse a revision that this code does not know: migrating does not help, and nothing may be written."""
    if found is None or found in known_revisions():
        return
    raise ServiceError(
        f"The database is of a newer Kilter: it has revision {found}, and this one knows no later than {HEAD}. Run the newer "
        "Kilter, or bring back a backup from before the update with `kilterd restore`. Nothing was changed.",
        code="database_newer",
        revision=found,
        needed=HEAD,
    )


def check_known(database: Database) -> None:
    """Refuse a database that is no older one either: of a newer Kilter, or of something else."""
    found = current(database)
    _refuse_newer(found)
    if found is None:
        raise ServiceError("This is not a database of Kilter: it has none of its tables.", code="database_outdated")


def has_seals(database: Database) -> bool:
    """Whether the database is of a release that seals its rows."""
    with database.reading() as session:
        return inspect(session.connection()).has_table(SealRow.__tablename__)


def known_revisions() -> frozenset[str]:
    """Return the revisions that this code has, read from the files: alembic takes a second to import."""
    found = (REVISION.search(path.read_text(encoding="utf-8")) for path in (migrations() / "versions").glob("*.py"))
    return frozenset(match[1] for match in found if match)


def wait(database: Database, seconds: float) -> None:
    """Wait until another process has migrated the database; raises as `check` does when it takes too long."""
    deadline = time.monotonic() + seconds
    while True:
        try:
            found = current(database)
            if found == HEAD:
                return
            _refuse_newer(found)
        except DatabaseAwayError:  # a machine that starts everything at once
            if time.monotonic() > deadline:
                raise
        if time.monotonic() > deadline:
            check(database)
        time.sleep(0.02)


def configuration(url: str) -> Config:
    """Return alembic's configuration for the database at ``url``."""
    from alembic.config import Config  # a second of import, needed only when there is something to migrate

    config = Config()
    config.set_main_option("script_location", str(migrations()))
    config.attributes["url"] = url
    return config


def migrate(database: Database) -> bool:
    """Bring the database to this code's revision; returns whether there was anything to do.

    Raises:
        ServiceError: the database is of a newer Kilter, or its tables are not of the revision that it names.

    """
    found = current(database)
    if found == HEAD:
        return False
    _refuse_newer(found)
    from alembic import command

    try:
        command.upgrade(configuration(database.url), "head")
    except DBAPIError as error:
        if in_words(error) is not None:
            raise
        what = f"The database names revision {found or 'none'}, and its tables are of another one ({error.orig})"
        raise _altered_error(what) from error
    return True


FILE = Path(__file__).with_name("schema.json")
Definitions = dict[str, list[str]]  # by kind and name: the parts of the definition, sorted
# Whoever writes the schema itself may take names like SQLite's own. What ANALYZE counts does not belong to it.
_SQLITE = text(
    "SELECT type, name, sql FROM sqlite_master WHERE sql IS NOT NULL "
    "AND NOT (type = 'table' AND name IN ('sqlite_stat1', 'sqlite_stat4'))"
)
# Of Kilter's tables alone: others may share a PostgreSQL database.
_POSTGRESQL = text(
    """
    WITH ours AS (SELECT oid, relname, relpersistence, relrowsecurity OR relforcerowsecurity AS hides
      FROM pg_class WHERE relname IN :tables AND relnamespace = current_schema()::regnamespace AND relkind IN ('r', 'p'))
    SELECT 'table ' || relname, concat_ws(' ', attname, format_type(atttypid, atttypmod),
           CASE WHEN attnotnull THEN 'NOT NULL' END, attgenerated, pg_get_expr(adbin, adrelid),
           CASE WHEN attcollation <> typcollation THEN attcollation::regcollation::text END)
    FROM ours JOIN pg_attribute ON attrelid = ours.oid AND attnum > 0 AND NOT attisdropped
         JOIN pg_type ON pg_type.oid = atttypid LEFT JOIN pg_attrdef ON adrelid = ours.oid AND adnum = attnum
    UNION ALL SELECT 'table ' || relname, conname || ' ' || pg_get_constraintdef(pg_constraint.oid, true)
    FROM ours JOIN pg_constraint ON conrelid = ours.oid AND contype IN ('c', 'f', 'p', 'u', 'x')
    UNION ALL SELECT 'table ' || relname, 'not in the log, a crash empties it' FROM ours WHERE relpersistence <> 'p'
    UNION ALL SELECT 'table ' || relname, 'rows hidden by policies' FROM ours WHERE hides
    UNION ALL SELECT DISTINCT 'table ' || relname, 'keys not enforced' FROM ours JOIN pg_trigger ON tgrelid = ours.oid
         AND tgisinternal AND tgenabled <> 'O'
    UNION ALL SELECT 'index ' || indexrelid::regclass::text, concat_ws(' ', pg_get_indexdef(indexrelid, 0, true),
           CASE WHEN NOT (indisvalid AND indisready AND indislive) THEN 'not valid' END)
    FROM ours JOIN pg_index ON indrelid = ours.oid
    UNION ALL SELECT 'trigger ' || tgname, concat_ws(' ', tgenabled, pg_get_triggerdef(pg_trigger.oid, true), prosrc,
           CASE WHEN prosecdef THEN 'SECURITY DEFINER' END, array_to_string(proconfig, ' '))
    FROM ours JOIN pg_trigger ON tgrelid = ours.oid AND NOT tgisinternal JOIN pg_proc ON pg_proc.oid = tgfoid
    UNION ALL SELECT 'rule ' || rulename, pg_get_ruledef(pg_rewrite.oid, true) FROM ours JOIN pg_rewrite ON ev_class = ours.oid
    """
).bindparams(bindparam("tables", (*Row.metadata.tables, "alembic_version"), expanding=True))


def schema_altered(connection: Connection) -> Iterator[str]:
    """Sentences about tables, indexes, triggers and rules that are not those of the revision."""
    expected: Definitions = json.loads(FILE.read_text(encoding="utf-8"))[connection.dialect.name]
    found = definitions(connection)
    for name in sorted(expected.keys() | found.keys()):
        if name not in found:
            yield f"The {name} is missing from the database."
        elif name not in expected:
            yield f"The {name} was put into the database past Kilter."
        elif found[name] != expected[name]:
            parts = sorted({*found[name]} ^ {*expected[name]})
            yield f"The {name} is not defined as Kilter does it: {'; '.join(parts)[:200]}"


def definitions(connection: Connection) -> Definitions:
    """Return how the database defines its tables, indexes, triggers and rules."""
    found: Definitions = {}
    if connection.dialect.name == "sqlite":
        for kind, name, sql in connection.execute(_SQLITE):
            parts = _parts(sql) if kind == "table" else [" ".join(sql.split())]
            found.setdefault(f"{kind} {name}", []).extend(parts)
    else:
        for name, part in connection.execute(_POSTGRESQL):
            found.setdefault(name, []).append(" ".join(part.split()))
    return {name: sorted(parts) for name, parts in found.items()}


def _parts(sql: str) -> list[str]:
    """Columns and constraints of a table's definition, sorted: a migration that copies a table may change their order."""
    body, depth, parts = " ".join(sql.split()).partition("(")[2].rpartition(")"), 0, [""]
    for character in body[0]:
        depth += (character == "(") - (character == ")")
        if character == "," and not depth:
            parts.append("")
        else:
            parts[-1] += character
    return sorted(part.strip() for part in (*parts, body[2]) if part.strip())
