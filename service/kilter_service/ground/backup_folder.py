"""The folder that backups are written into by a timer: how old the newest is, and which ones go.

Whether a database is being migrated: on a slow disk that takes minutes, in which others must not even open it.

Digests of bytes: the SHA-256 beside a backup, and that which a client sends with a body (RFC 9530).
"""

from __future__ import annotations

import base64
import binascii
import fcntl
import hashlib
import re
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.private_files import private_folder

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


PIECE_BYTES = 1 << 20

HEADERS = ("content-digest", "repr-digest", "digest")  # the last by RFC 3230, which the others replaced
MEMBER = re.compile(r"\s*([A-Za-z0-9*_-]+)\s*=\s*:?([A-Za-z0-9+/=_-]*):?\s*(?:;.*)?")
SHA256 = "sha-256"


def hash_file(path: Path) -> Path:
    """Return where the hash of a backup lies."""
    return path.with_name(f"{path.name}.sha256")


def write_hash(path: Path) -> None:
    """Put the hash of a backup beside it."""
    hash_file(path).write_text(f"{_sha256(path)}  {path.name}\n", encoding="utf-8")


def has_hash(path: Path) -> bool:
    """Whether a backup has the hash that lies beside it; one that lost that file has its manifest."""
    beside = hash_file(path)
    return not beside.exists() or beside.read_bytes().split()[:1] == [_sha256(path).encode()]


def check_hash(path: Path) -> None:
    """Refuse a backup that is not what was written.

    Raises:
        ServiceError: it was altered.

    """
    if not has_hash(path):
        raise ServiceError(
            f"{path} does not have the hash in {hash_file(path).name}: it was changed or copied badly. Take another copy, "
            "or an older backup.",
            code="database_damaged",
        )


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(PIECE_BYTES):
            digest.update(piece)
    return digest.hexdigest()


def check_digest(headers: Mapping[str, str], sha256: str) -> None:
    """Refuse bytes that are not those the client has hashed. Digests by other algorithms are passed over, as the RFC says.

    Raises:
        ServiceError: they are others, or the header cannot be read.

    """
    for name in HEADERS:
        for stated in _parse_digest_header(name, headers.get(name, "")):
            if stated != bytes.fromhex(sha256):
                raise ServiceError(
                    f"What arrived is not what was sent: its SHA-256 is {sha256}, {name.title()} says {stated.hex()}. "
                    "Nothing was stored; send it again.",
                    code="digest_mismatch",
                    sha256=sha256,
                )


def _parse_digest_header(name: str, text: str) -> list[bytes]:
    found = []
    for member in filter(str.strip, text.split(",")):
        match = MEMBER.fullmatch(member)
        if match and match[1].lower() != SHA256:
            continue
        try:
            found.append(base64.b64decode(match[2] if match else "?", validate=True))
        except binascii.Error as error:
            raise ServiceError(
                f"{name.title()} is {member.strip()[:80]!r}: write it as sha-256=:BASE64: (RFC 9530).",
                code="payload_invalid",
            ) from error
    return found
