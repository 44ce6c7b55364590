"""Back up, restore and verify, whatever runs meanwhile.

A backup is one SQLite file with all rows of one snapshot, also of a PostgreSQL database: it is restored into either.
Jobs that were not over are queued again when a worker finds them.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import sqlite3
import struct
import tempfile
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from kilter_service.ground.backup_folder import check_hash, has_hash, hash_file, name_now, write_hash
from kilter_service.ground.db import Database, revision
from kilter_service.ground.db.failures import in_words
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.private_files import private_file, private_folder
from kilter_service.ground.settings import DATABASE_FILE, JOBS_FILE, LOCK_FILE, Settings
from kilter_service.run.backup import store
from kilter_service.run.backup.store import Findings
from kilter_service.run.backup.upgrade import replay_and_keep

if TYPE_CHECKING:
    from kilter_service.versions.replays import Change

# The manifest of a backup: a hash for every table, over all of its rows, taken when the backup was written.
#
# Chunks, robots, calibrations and shapes carry hashes of their own; reports, results, roles, tokens and activations
# do not, and a flipped bit in one of them was restored without a word. The manifest is a table of the backup file
# alone: it is compared with the file's own columns, before any migration, and taken out when the backup is restored.

NAME = "kilter_manifest"
INSERT = "INSERT INTO kilter_manifest VALUES (?, ?, ?)"
SELECT = "SELECT name, rows, sha256 FROM kilter_manifest"
_TABLES = (
    "SELECT name, sql FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite\\_%' ESCAPE '\\' ORDER BY name"
)


def write(path: Path) -> None:
    """Add the manifest to a backup that holds all its rows."""
    with closing(_open_with_raw_text(path)) as file, file:
        found = _hashes(file)
        file.execute(f"CREATE TABLE {NAME} (name TEXT PRIMARY KEY, rows INTEGER, sha256 TEXT)")
        file.executemany(INSERT, [(name, *rest) for name, rest in found.items()])


def compare(path: Path) -> list[str] | None:
    """Sentences about the tables that are not as they were written; None when the backup has no manifest.

    Raises:
        sqlite3.DatabaseError: a page of the file cannot be read.

    """
    with closing(_open_with_raw_text(path)) as file:
        listed = {name.decode() for name, _ in file.execute(_TABLES)}
        if NAME not in listed:
            return None
        written = {name.decode(): (rows, sha256.decode()) for name, rows, sha256 in file.execute(SELECT)}
        found = _hashes(file)
    said = [f"Table {name} is missing from the backup." for name in sorted(written.keys() - found.keys())]
    said += [
        f"Table {name} was not there when the backup was written." for name in sorted(found.keys() - written.keys())
    ]
    return said + [
        _difference(name, written[name], found[name])
        for name in sorted(written.keys() & found.keys())
        if written[name] != found[name]
    ]


def remove(path: Path) -> None:
    """Take the manifest out of a copy that is going to be used."""
    with closing(_open_with_raw_text(path)) as file, file:
        file.execute(f"DROP TABLE IF EXISTS {NAME}")


def _difference(name: str, written: tuple[int, str], found: tuple[int, str]) -> str:
    if written[0] != found[0]:
        return f"Table {name} has {found[0]} rows; {written[0]} were written."
    return f"Table {name} does not have the hash {written[1][:12]} it was written with: at least one of its rows was altered."


def _open_with_raw_text(path: Path) -> sqlite3.Connection:
    file = sqlite3.connect(path)
    file.text_factory = bytes  # text that is no longer text is compared, and does not end in an error of decoding
    return file


def _hashes(file: sqlite3.Connection) -> dict[str, tuple[int, str]]:
    """Number of rows and hash of every table, of its definition too."""
    found = {}
    for name, definition in file.execute(_TABLES).fetchall():
        table = name.decode()
        if table == NAME:
            continue
        digest, rows = hashlib.sha256(definition), 0
        quoted = table.replace('"', '""')
        for row in file.execute(f'SELECT * FROM "{quoted}" ORDER BY rowid'):  # noqa: S608 (a name from the file, quoted)
            rows += 1
            for value in row:
                _feed(digest, value)
        found[table] = rows, digest.hexdigest()
    return found


def _feed(digest: hashlib._Hash, value: bytes | int | float | None) -> None:
    """Add a value, its kind and length with it, so that no two rows give the same bytes."""
    if value is None:
        digest.update(b"n")
    elif isinstance(value, int):
        digest.update(b"i%d;" % value)
    elif isinstance(value, float):
        digest.update(b"f" + struct.pack("<d", value))
    else:
        digest.update(b"b%d;" % len(value))
        digest.update(value)


PAGES_AT_ONCE = 2000  # of a copy: writers go on in between


def backup(settings: Settings, where: Path) -> tuple[Path, Findings]:
    """Write a backup to a file, or into a folder under a name with the time; it is there whole or not at all.

    Raises:
        ServiceError: the file exists, or the database is damaged or of another revision.

    """
    path = where / name_now() if where.is_dir() else where
    if path.exists():
        raise ServiceError(f"{path} exists: give another name, backups are never written over.", code="backup_refused")
    part = path.with_name(f"{path.name}.part")
    part.unlink(missing_ok=True)
    private_file(part)
    database = Database(settings.database)
    try:
        _check_readable(settings, database)
        if settings.database_url is None:
            _copy_file(settings.data / DATABASE_FILE, part)
        else:
            _copy_rows(database, part)
        found = _migrate_and_check(part)
        if found.other_key:
            raise ServiceError(found.other_key, code="seal_key_other")
        _refuse_damaged(found, "The database is damaged, so there is no new backup")
        if found.revision != revision.HEAD:
            _replay_and_keep(part, found)
        write(part)
        found.every_row = True
        _put(part, path)
        write_hash(path)
    finally:
        database.close()
        _remove(part)
    return path, found


def restore(settings: Settings, path: Path, *, accept: bool = False) -> tuple[Findings, tuple[Change, ...]]:
    """Put a backup where no data are yet; it is checked first, and brought to the revision of this Kilter.

    Returns what was looked at, and how the answers of active versions change from those that were kept.

    ``accept`` restores one whose seals cannot be compared, because it is sealed with another key or with none.

    Raises:
        ServiceError: the file is damaged, sealed with another key or of a newer Kilter, the target has data, or a server
            runs there.

    """
    if not path.is_file():
        raise ServiceError(
            f"There is no backup {path}: give the file that `kilterd backup` wrote.", code="backup_refused"
        )
    check_hash(path)
    private_folder(settings.data)
    with (settings.data / LOCK_FILE).open("w", encoding="ascii") as lock:
        _lock(lock.fileno(), settings.data)
        _refuse_full(settings)
        part = settings.data / f"{DATABASE_FILE}.part"
        try:
            found = _checked_copy(path, part)
            if found.other_key and not accept:
                raise ServiceError(
                    f"{path} was not restored, its seals cannot be compared. {found.other_key} `kilterd restore --accept` "
                    "takes it as it is.",
                    code="seal_key_other",
                )
            _refuse_damaged(found, f"{path} is damaged and was not restored")
            changes = _replay_and_keep(part, found)
            if settings.database_url is None:
                _put(part, settings.data / DATABASE_FILE)
            else:
                _restore_rows(settings, part)
        finally:
            _remove(part)
    return found, changes


def verify(path: Path) -> Findings:
    """Check a backup; the file itself is not opened by SQLite, which would write into it."""
    if not path.is_file():
        raise ServiceError(
            f"There is no backup {path}: give the file that `kilterd backup` wrote.", code="backup_refused"
        )
    with tempfile.TemporaryDirectory(prefix="kilter-verify-") as folder:
        found = _checked_copy(path, Path(folder) / "copy.sqlite")
    if not has_hash(path):
        found.add(f"The backup does not have the hash in {hash_file(path).name}: one of the two was altered.")
    return found


def verify_stored(settings: Settings, *, quick: bool = False) -> Findings:
    """Check the database of a server while it is in use; of one of an earlier revision, a copy that is migrated."""
    database = Database(settings.database)
    try:
        _check_readable(settings, database)
        if revision.current(database) != revision.HEAD:
            if quick:  # to copy and migrate it is not
                revision.check(database)
            with tempfile.TemporaryDirectory(prefix="kilter-verify-", dir=settings.data) as folder:
                copy = Path(folder) / "copy.sqlite"
                private_file(copy)
                _copy_file(settings.data / DATABASE_FILE, copy)
                return _migrate_and_check(copy)
        return store.check(database, quick=quick)
    except Exception as error:
        return _damage(error)
    finally:
        database.close()


def seal(settings: Settings, *, accept: bool) -> list[str]:
    """Seal all rows anew, with the key in use; returns what keeps it from doing so."""
    database = Database(settings.database)
    try:
        if revision.current(database) != revision.HEAD:
            revision.check(database)
        return store.seal(database, accept=accept)
    finally:
        database.close()


def _check_readable(settings: Settings, database: Database) -> None:
    """Refuse a database of a newer Kilter, and one of an earlier revision that is not a file: its rows are not read here."""
    if settings.database_url is None:
        revision.check_known(database)
    else:
        revision.check(database)


def _replay_and_keep(part: Path, found: Findings) -> tuple[Change, ...]:
    """Give a copy that was brought to this revision what active versions of its release lack."""
    with closing(Database(f"sqlite:///{part}")) as database:
        changes = replay_and_keep(database, found.revision)
    _one_file(part)
    return changes


def _checked_copy(path: Path, copy: Path) -> Findings:
    """Copy a backup, bring the copy to the revision of this Kilter and check it."""
    private_file(copy)
    shutil.copyfile(path, copy)
    try:
        altered = compare(copy)
        remove(copy)
    except sqlite3.DatabaseError as error:
        return _damage(error)
    found = _migrate_and_check(copy)
    found.damaged[:0] = altered or []
    found.every_row = altered is not None
    return found


def _migrate_and_check(path: Path) -> Findings:
    database = Database(f"sqlite:///{path}")
    try:
        revision.check_known(database)
        sealed, of_revision = revision.has_seals(database), revision.current(database)
        revision.migrate(database)
        found = store.check(database)
        found.sealed, found.revision = sealed, of_revision
        return found
    except Exception as error:
        return _damage(error)
    finally:
        database.close()
        _one_file(path)


def _damage(error: Exception) -> Findings:
    """What is found when the database cannot even be opened; other errors are raised again."""
    known = in_words(error)
    if known is None or known.code != "database_damaged":
        raise error
    return Findings([known.message])


def _one_file(path: Path) -> None:
    """Take what is in SQLite's log into the file; a damaged one stays as it is."""
    with suppress(sqlite3.DatabaseError), closing(sqlite3.connect(path)) as file:
        file.execute("PRAGMA journal_mode=DELETE")


def _copy_file(source: Path, target: Path) -> None:
    with closing(sqlite3.connect(source)) as read, closing(sqlite3.connect(target)) as written:
        read.backup(written, pages=PAGES_AT_ONCE, sleep=0.001)


def _copy_rows(source: Database, target: Path) -> None:
    written = Database(f"sqlite:///{target}")
    try:
        revision.migrate(written)
        store.copy(source, written)
    finally:
        written.close()


def _refuse_full(settings: Settings) -> None:
    """Refuse a target that has data."""
    if settings.database_url is None:
        there = [name for name in (DATABASE_FILE, JOBS_FILE) if (settings.data / name).exists()]
        if there:
            raise ServiceError(
                f"{settings.data} has data already ({', '.join(there)}): restore into an empty folder with --data, or move "
                "these files away first.",
                code="backup_refused",
            )
        return
    target = Database(settings.database)
    try:
        if revision.current(target) is not None and _has_rows(target):
            raise ServiceError(
                "The database of KILTER_DATABASE_URL has data already: restore into an empty one.",
                code="backup_refused",
            )
    finally:
        target.close()


def _has_rows(target: Database) -> bool:
    revision.migrate(target)  # an empty one of an older Kilter will do
    return store.has_rows(target)


def _restore_rows(settings: Settings, part: Path) -> None:
    source, target = Database(f"sqlite:///{part}"), Database(settings.database)
    try:
        revision.migrate(target)
        store.copy(source, target)
    finally:
        source.close()
        target.close()


def _remove(part: Path) -> None:
    for left in part.parent.glob(f"{part.name}*"):
        left.unlink()


def _refuse_damaged(found: Findings, what: str) -> None:
    if found.damaged:
        more = f" (and {len(found.damaged) - 1} more)" if len(found.damaged) > 1 else ""
        raise ServiceError(
            f"{what}: {found.damaged[0]}{more} `kilterd verify` lists all; take an older backup.",
            code="database_damaged",
        )


def _lock(descriptor: int, data: Path) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        raise ServiceError(
            f"A server runs in {data}: stop it, or restore into another folder with --data.", code="data_in_use"
        ) from error


def _put(part: Path, path: Path) -> None:
    """Give a file its name once its bytes are on the disk."""
    with part.open("rb") as file:
        os.fsync(file.fileno())
    part.rename(path)
    folder = os.open(path.parent, os.O_RDONLY)
    with suppress(OSError):  # some file systems cannot
        os.fsync(folder)
    os.close(folder)
