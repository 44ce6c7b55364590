"""Signed messages of the stream (KLT2), as docs/reference/stream.md tables them: standard library only.

A frame carries a session id and a tag. Its key is made of the session's key and a nonce that the corrector gives, so that
frames and answers of an earlier session, or of a corrector that was restarted, do not fit any more.
"""

from __future__ import annotations

import contextlib
import json
import secrets
import struct
import time
from collections import deque
from collections.abc import Mapping
from hashlib import blake2s
from hmac import compare_digest
from pathlib import Path
from typing import Any, NamedTuple

MAGIC, PLAIN = b"KLT2", b"KLT1"
ID = struct.Struct("<IIQ")  # number of the master secret, time of expiry in s since 1970, random
HEADER = struct.Struct("<4sBBHQQQ")
TAG, TRAILER, NONCE = 16, 32, 16
HELLO = 3
STATUS = slice(44, 46)
NO_SESSION, SESSION_EXPIRED = 12, 14
CHALLENGE_BYTES = 56 + NONCE + TRAILER
SIGNATURE = b', "signature": "'
LIFETIME_S = 86_400.0


class Session(NamedTuple):
    """A session of one stream: its id, its key, and the key of what the corrector says about the robot."""

    id: bytes
    key: bytes
    robot_key: bytes

    @property
    def master(self) -> int:
        """Number of the secret from which the keys were derived."""
        return int(ID.unpack(self.id)[0])

    @property
    def expires_s(self) -> int:
        """When the session ends, s since 1970."""
        return int(ID.unpack(self.id)[1])


def from_document(document: Mapping[str, Any]) -> Session:
    """The session in an answer of the API."""
    found = (bytes.fromhex(str(document[name])) for name in ("session", "key", "announcement_key"))
    return Session(*found)


def on_this_machine(file: Path, site: str, robot: str, stream: str, lifetime_s: float = LIFETIME_S) -> Session | None:
    """A new session from the master secret of a corrector of this account; None when its file cannot be read."""
    try:
        row = json.loads(file.read_text(encoding="ascii"))["keys"][-1]
        secret = bytes.fromhex(row["secret"])
    except (OSError, ValueError, KeyError, IndexError, TypeError):
        return None
    master = blake2s(b"", key=secret, digest_size=4, person=b"KLT2mid").digest()
    made = master + struct.pack("<IQ", int(time.time() + lifetime_s), secrets.randbits(64))
    key = _derive_key(secret, b"KLT2key", made + f"{site}\0{robot}\0{stream}".encode())
    return Session(made, key, _derive_key(secret, b"KLT2robt", f"{site}\0{robot}".encode()))


def _derive_key(key: bytes, use: bytes, message: bytes) -> bytes:
    return blake2s(message, key=key, digest_size=32, person=use).digest()


def _tag(key: bytes, use: bytes, message: bytes) -> bytes:
    return blake2s(message, key=key, digest_size=TAG, person=use).digest()


class _Keys(NamedTuple):
    """A session in use and the key that the corrector's nonce gave it."""

    session: bytes
    key: bytes


class Signer:
    """Signs the frames of one stream and checks what comes back.

    :meth:`greeting` asks the corrector for its nonce; :meth:`accept_challenge` takes it. Until then nothing can be signed.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self._next: Session | None = None  # what the stream changes to, once the corrector has given its nonce
        self._in_use: _Keys | None = None
        self._before: _Keys | None = None  # answers to what was signed with it are on their way
        self._greetings: deque[bytes] = deque(maxlen=8)

    @property
    def ready(self) -> bool:
        """Whether frames can be signed."""
        return self._in_use is not None

    def renew(self, session: Session) -> None:
        """Change to another session as soon as the corrector has answered its greeting."""
        self._next = session

    def greeting(self) -> bytes:
        """A frame that asks for the nonce."""
        session = self._next or self.session
        head = HEADER.pack(MAGIC, HELLO, 0, 0, secrets.randbits(62), secrets.randbits(62), 0)
        self._greetings.append(head[8:32])
        data = head + session.id
        return data + _tag(session.key, b"KLT2helo", data)

    def sign_frame(self, plain: bytes) -> bytes:
        """A signed frame from a plain one."""
        assert self._in_use is not None
        session, key = self._in_use
        data = MAGIC + plain[4:] + session
        return data + _tag(key, b"KLT2in", data)

    def verify_answer(self, data: bytes) -> bytes | None:
        """The plain answer in a signed one; None when its tag is wrong."""
        if data[:4] != MAGIC or len(data) < 32 + TRAILER:
            return None
        for keys in (self._in_use, self._before):
            known = keys is not None and data[-TRAILER:-TAG] == keys.session
            if keys is not None and known and compare_digest(_tag(keys.key, b"KLT2out", data[:-TAG]), data[-TAG:]):
                return PLAIN + data[4:-TRAILER]
        return None

    def accept_challenge(self, data: bytes, last: bytes) -> int | None:
        """Take the corrector's nonce; the status when ``data`` answers a greeting or the frame ``last`` echoes, else None."""
        if len(data) != CHALLENGE_BYTES or data[:4] != MAGIC:
            return None
        session = next((s for s in (self._next, self.session) if s and s.id == data[-TRAILER:-TAG]), None)
        if session is None or data[8:32] not in (*self._greetings, last):
            return None
        if not compare_digest(_tag(session.key, b"KLT2chal", data[:-TAG]), data[-TAG:]):
            return None
        with contextlib.suppress(ValueError):
            self._greetings.remove(data[8:32])  # once only: a recording of this answer must not bring an old nonce back
        status = int.from_bytes(data[STATUS], "little")
        if status == NO_SESSION:
            nonce = data[56 : 56 + NONCE]
            self._before = self._in_use
            self._in_use = _Keys(session.id, _derive_key(session.key, b"KLT2work", nonce))
            self.session, self._next = session, None if session is self._next else self._next
        return status

    def verify_announcement(self, address: str, payload: bytes) -> bytes | None:
        """What the corrector announces about the robot, without its signature; None when that is wrong."""
        body, signature = _split(payload)
        expected = _tag(self.session.robot_key, b"KLT2said", address.encode() + b"\0" + body).hex()
        for one in signature.split(" "):
            number, _, tag = one.partition(":")
            if number == f"{self.session.master:08x}" and compare_digest(tag, expected):
                return body
        return None

    def question(self) -> bytes:
        """What to send with a question; its last 16 bytes are the nonce of the reply."""
        return self.session.id + secrets.token_bytes(NONCE)

    def verify_reply(self, question: bytes, address: str, payload: bytes) -> bytes | None:
        """The reply to a question, without its signature; None when that is wrong."""
        body, signature = _split(payload)
        message = question[-NONCE:] + address.encode() + b"\0" + body
        return body if compare_digest(signature, _tag(self.session.key, b"KLT2rply", message).hex()) else None


def _split(payload: bytes) -> tuple[bytes, str]:
    """A signed document as the bytes that were signed, and the signature; empty when there is none."""
    at = payload.rfind(SIGNATURE)
    if at < 0 or not payload.endswith(b'"}'):
        return payload, ""
    signature = payload[at + len(SIGNATURE) : -2]
    return payload[:at] + b"}", signature.decode("ascii") if signature.isascii() else ""
