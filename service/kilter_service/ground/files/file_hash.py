"""Digests of bytes: the SHA-256 beside a backup, and that which a client sends with a body (RFC 9530)."""

from __future__ import annotations

import base64
import binascii
import hashlib
import re
from collections.abc import Mapping
from pathlib import Path

from kilter_service.ground.errors import ServiceError

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
