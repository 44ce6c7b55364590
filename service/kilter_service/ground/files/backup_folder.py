"""The folder that backups are written into by a timer: how old the newest is, and which ones go."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.files.file_hash import has_hash, hash_file

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
