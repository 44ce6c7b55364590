"""The SHA-256 that lies beside a backup, as `sha256sum --check` reads it."""

from __future__ import annotations

import hashlib
from pathlib import Path

from kilter_service.ground.errors import ServiceError

PIECE_BYTES = 1 << 20


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
