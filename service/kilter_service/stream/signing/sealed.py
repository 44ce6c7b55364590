"""Bytes of a signed frame (KLT2) and of signed documents, as docs/reference/stream.md tables them.

A signed frame is a plain one with the magic ``KLT2``, followed by the session id (16 bytes) and a tag (16 bytes): keyed
BLAKE2s over everything before the tag. Each use of a key has its own personalisation, so that no signed message can be
passed off as one of another kind. docs/explanation/corrected-stream.md has the argument.
"""

from __future__ import annotations

import struct
from hashlib import blake2s
from hmac import compare_digest
from typing import Any, NamedTuple

PLAIN, MAGIC = b"KLT1", b"KLT2"
ID = struct.Struct("<IIQ")  # number of the master secret, time of expiry (s since 1970), random
SESSION_BYTES, TAG_BYTES, NONCE_BYTES = ID.size, 16, 16
TRAILER = SESSION_BYTES + TAG_BYTES
HELLO = 3  # kind of a frame that asks for the corrector's nonce
HEADER, VERDICT = 32, 24
SIGNATURE = b', "signature": "'

# What a key is used for
KEY_OF_SESSION, KEY_OF_ROBOT, KEY_IN_USE, KEY_NUMBER = b"KLT2key", b"KLT2robt", b"KLT2work", b"KLT2mid"
SETPOINT, ANSWER, GREETING, CHALLENGE = b"KLT2in", b"KLT2out", b"KLT2helo", b"KLT2chal"
QUESTION, REPLY, ANNOUNCEMENT = b"KLT2ask", b"KLT2rply", b"KLT2said"


class Session(NamedTuple):
    """What a session id says; its key is derived from the master secret of that number."""

    master: int
    expires_s: int
    random: int

    def encode(self) -> bytes:
        """The 16 bytes of the id."""
        return ID.pack(*self)


def session_id_from_frame(data: bytes) -> bytes:
    """Session id of a signed frame."""
    return data[-TRAILER:-TAG_BYTES]


def is_signed(data: bytes) -> bool:
    """Whether bytes look like a signed frame; its tag is not checked."""
    return data[:4] == MAGIC and len(data) >= HEADER + TRAILER


def hasher(key: bytes, use: bytes) -> Any:
    """The state of a tag before its message; it is copied for each message."""
    return blake2s(key=key, digest_size=TAG_BYTES, person=use)


def tag(key: bytes, use: bytes, message: bytes) -> bytes:
    """Tag of a message."""
    return blake2s(message, key=key, digest_size=TAG_BYTES, person=use).digest()


def fits(key: bytes, use: bytes, data: bytes) -> bool:
    """Whether the last 16 bytes of ``data`` are the tag of what is before them."""
    return compare_digest(tag(key, use, data[:-TAG_BYTES]), data[-TAG_BYTES:])


def derive_key(key: bytes, use: bytes, message: bytes) -> bytes:
    """A key of 32 bytes made from another one."""
    return blake2s(message, key=key, digest_size=32, person=use).digest()


def secret_number(secret: bytes) -> int:
    """Number by which a session id names its master secret; it tells nothing about the secret."""
    return int.from_bytes(blake2s(b"", key=secret, digest_size=4, person=KEY_NUMBER).digest(), "little")


def session_key(secret: bytes, session: bytes, site: str, robot: str, stream: str) -> bytes:
    """Key of a session: of this site, robot and stream only."""
    return derive_key(secret, KEY_OF_SESSION, session + "\0".join((site, robot, stream)).encode())


def robot_key(secret: bytes, site: str, robot: str) -> bytes:
    """Key of the corrector's announcements about a robot."""
    return derive_key(secret, KEY_OF_ROBOT, f"{site}\0{robot}".encode())


def key_in_use(key: bytes, nonce: bytes) -> bytes:
    """Key of the frames of a session, once the corrector has given its nonce."""
    return derive_key(key, KEY_IN_USE, nonce)


def sign_frame(plain: bytes, session: bytes, key: bytes, use: bytes, before: bytes = b"") -> bytes:
    """A signed frame from a plain one; ``before`` is signed too, but not sent."""
    data = MAGIC + plain[4:] + session
    return data + tag(key, use, before + data)


def strip_signature(data: bytes) -> bytes:
    """The plain frame of a signed one, whose tag was checked before."""
    return PLAIN + data[4:-TRAILER]


def signed_document(body: bytes, signature: str) -> bytes:
    """A JSON object with the signature as its last field; the signature is over the object without it."""
    return body[:-1] + SIGNATURE + signature.encode() + b'"}'


def said_tag(key: bytes, address: str, body: bytes) -> bytes:
    """Tag of an announcement about a robot, on one zenoh key."""
    return tag(key, ANNOUNCEMENT, address.encode() + b"\0" + body)


def reply_tag(key: bytes, nonce: bytes, address: str, body: bytes) -> bytes:
    """Tag of the reply to a question that contained ``nonce``."""
    return tag(key, REPLY, nonce + address.encode() + b"\0" + body)


def opened_document(data: bytes) -> tuple[bytes, dict[int, bytes]] | None:
    """The object that was signed, and the tags by the number of their master secret; None for anything else."""
    body, found, rest = data.rpartition(SIGNATURE)
    if not found or not rest.endswith(b'"}'):
        return None
    try:
        pairs = [part.split(":") for part in rest[:-2].decode("ascii").split(" ")]
        return body + b"}", {int(number, 16): bytes.fromhex(given) for number, given in pairs}
    except ValueError:
        return None
