"""The digest that a client sends with a body (RFC 9530), compared with that of the bytes which arrived."""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Mapping

from kilter_service.ground.errors import ServiceError

HEADERS = ("content-digest", "repr-digest", "digest")  # the last by RFC 3230, which the others replaced
MEMBER = re.compile(r"\s*([A-Za-z0-9*_-]+)\s*=\s*:?([A-Za-z0-9+/=_-]*):?\s*(?:;.*)?")
SHA256 = "sha-256"


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
