"""The folder that backups are written into by a timer: how old the newest is, and which ones go.

Whether a database is being migrated: on a slow disk that takes minutes, in which others must not even open it.
"""

from __future__ import annotations

import fcntl
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.files.file_hash import has_hash, hash_file
from kilter_service.ground.files.private_files import private_folder

SUFFIX = ".kilter-backup"
WHEN = "%Y%m%dT%H%M%SZ"
NAME = re.compile(rf"kilter-(\d{{8}}T\d{{6}}Z){re.escape(SUFFIX)}")


@dataclass(frozen=True)
class Backup:
    """A backup and when it was made, by its name."""

    path: Path
    at: datetime

    def age_s(self) -> float:
        """Seconds since it was made."""
        return (datetime.now(UTC) - self.at).total_seconds()


@dataclass
class Kept:
    """What became of the backups of a folder."""

    removed: list[Path] = field(default_factory=list)
    altered: list[Path] = field(default_factory=list)
    left: int = 0


def name_now() -> str:
    """Return the name of a backup that is made now."""
    return f"kilter-{datetime.now(UTC):{WHEN}}{SUFFIX}"


def backups(folder: Path) -> list[Backup]:
    """Return the backups of a folder that are named after their time and have their hash beside them, newest first.

    A backup gets its name and then its hash when it is whole; what was cut off has neither.
    """
    found = []
    for path in folder.iterdir():
        matched = NAME.fullmatch(path.name)
        if matched is None or not hash_file(path).exists():
            continue
        try:
            at = datetime.strptime(matched[1], WHEN).replace(tzinfo=UTC)
        except ValueError:  # 99 days, say
            continue
        found.append(Backup(path, at))
    return sorted(found, key=lambda backup: backup.at, reverse=True)


def check_folder(folder: Path) -> None:
    """Refuse a folder that is not there.

    Raises:
        ServiceError: it is not there, or is a file.

    """
    if not folder.is_dir():
        raise ServiceError(
            f"There is no folder {folder}: make it (`mkdir`) for the account of the server, or correct KILTER_BACKUPS.",
            code="backup_refused",
        )


def keep_newest(folder: Path, number: int) -> Kept:
    """Remove the backups of a folder beyond its newest ones. What was altered counts for none of them, and stays."""
    kept = Kept()
    for backup in backups(folder):
        if kept.left >= number:
            backup.path.unlink()
            hash_file(backup.path).unlink(missing_ok=True)
            kept.removed.append(backup.path)
        elif has_hash(backup.path):
            kept.left += 1
        else:
            kept.altered.append(backup.path)
    return kept


LOCK_FILE = "migration.lock"
LOOK_S = 0.02


@contextmanager
def migration_lock(data: Path) -> Iterator[None]:
    """Hold the lock of a data folder; one process after the other migrates. It ends with the process, however it ends."""
    with (private_folder(data) / LOCK_FILE).open("w", encoding="ascii") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            fcntl.flock(file, fcntl.LOCK_UN)


def is_migrating(data: Path) -> bool:
    """Whether another process migrates the database of a data folder."""
    try:
        with (data / LOCK_FILE).open(encoding="ascii") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # there is no such file, or no such folder
        return False
    return False


def wait_for_migration(data: Path) -> None:
    """Wait for the end of a migration, however long it takes: whoever migrates says what goes wrong."""
    while is_migrating(data):
        time.sleep(LOOK_S)
