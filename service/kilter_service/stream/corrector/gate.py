"""Who may send setpoints: checks signed frames of a process, and answers those that are of no session in use.

The keys of a session follow from the master secret, so nothing about sessions is stored. Against replays the corrector
gives a nonce: the frames of a session are signed with a key made of the session's key and this nonce. The nonce follows from a
secret that this process draws at its start, and again whenever a stream loses its slot; so a frame recorded before a restart,
or before the stream lost its slot, has no valid key any more.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.wire import Status
from kilter_service.stream.signing import sealed
from kilter_service.stream.signing.masters import Masters
from kilter_service.stream.signing.sealed import Session


class Address(NamedTuple):
    """What the key of a session is bound to."""

    site: str
    robot: str
    stream: str


class Admitted(NamedTuple):
    """A session whose frame was signed with the key in use."""

    session: bytes
    key: bytes
    ends_ns: int  # monotonic clock


@dataclass
class Gate:
    """Secrets of a process. ``unsigned``: whether plain frames are taken at all."""

    masters: Masters
    unsigned: bool = True
    secret: bytes = field(default_factory=lambda: os.urandom(sealed.NONCE_BYTES))
    dropped: Counter[str] = field(default_factory=Counter)  # frames that got no answer, by reason

    def forget(self) -> None:
        """Make all nonces given so far useless: a stream lost its slot, and its sequence with it."""
        self.secret = os.urandom(sealed.NONCE_BYTES)

    def admit(
        self, address: Address, data: bytes, current: bytes = b"", secret: bytes = b""
    ) -> Admitted | bytes | None:
        """The session of a signed frame, an answer that refuses it, or None: the frame gets no answer.

        ``current`` is the session in use on the stream, ``secret`` the one that its nonces follow from.
        """
        session = sealed.session_id_from_frame(data)
        key = self.masters.session_key(session, *address)
        if key is None:  # nothing could be said that the sender could check
            self.dropped["unknown_key"] += 1
            return None
        left_s = Session(*sealed.ID.unpack(session)).expires_s - time.time()
        if left_s <= 0:
            return self._refusal(data, session, key, Status.SESSION_EXPIRED, bytes(sealed.NONCE_BYTES))
        nonce = sealed.derive_key(secret or self.secret, sealed.CHALLENGE, "\0".join(address).encode() + session)
        nonce = nonce[: sealed.NONCE_BYTES]
        in_use = sealed.key_in_use(key, nonce)
        if sealed.fits(in_use, sealed.SETPOINT, data):
            return Admitted(session, in_use, time.monotonic_ns() + int(left_s * 1e9))
        greeting = data[4] == sealed.HELLO and sealed.fits(key, sealed.GREETING, data)
        if session == current and not greeting:
            # The session is in use, so its controller has the nonce, and this is somebody else's. An answer would be the
            # echo of a setpoint, with a refusal that its controller believes.
            self.dropped["forged"] += 1
            return None
        return self._refusal(data, session, key, Status.NO_SESSION, nonce)

    def _refusal(self, data: bytes, session: bytes, key: bytes, status: Status, nonce: bytes) -> bytes:
        kind = data[4]
        plain = (
            wire.encode_refusal(wire.decode_header(sealed.strip_signature(data))._replace(kind=kind), status) + nonce
        )
        return sealed.sign_frame(plain, session, key, sealed.CHALLENGE)


def unsigned_refusal(data: bytes) -> bytes | None:
    """The answer to a plain frame where frames must be signed; None when it has no header."""
    try:
        return wire.encode_refusal(wire.decode_header(data), Status.UNSIGNED)
    except wire.FrameError:
        return None
