"""The revision that the database has, the one that this code needs, and the migration between them."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import TYPE_CHECKING

from sqlalchemy import inspect, text
from sqlalchemy.exc import DBAPIError

from kilter_service.ground.db.database import Database, DatabaseAwayError
from kilter_service.ground.db.database_seal import check_key
from kilter_service.ground.db.failures import in_words
from kilter_service.ground.db.seal_tables import SealRow
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
