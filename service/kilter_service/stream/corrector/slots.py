"""The streams that are served: who gets a slot, and who gives it back.

Anybody who reaches the corrector can make up names. So a robot without a version has no slots, a stream in good use keeps
its own whatever else comes in; of all others, the one whose last good setpoint is the oldest loses its slot. A stream that
loses its slot loses its sequence, so the nonces given until then lose their use.

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
from hmac import compare_digest
from typing import Any, NamedTuple

import zenoh

from kilter_service.stream.corrector import endpoints, wire
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.session import ENCODING, Rules
from kilter_service.stream.corrector.stream import Stream
from kilter_service.stream.corrector.wire import Status
from kilter_service.stream.signing import sealed
from kilter_service.stream.signing.masters import Masters
from kilter_service.stream.signing.sealed import Session

SEQ = slice(8, 16)
from_bytes = int.from_bytes


class Guard:
    """Answers the bytes that arrive on one stream, signed or plain."""

    def __init__(self, gate: Gate, address: Address, stream: Stream) -> None:
        self.stream = stream
        self.replayed = 0
        self._gate = gate
        self._address = address
        self._session = b""
        self._ends_ns = 0
        self._highest = -1  # sequence number of the signed frames; a RESET does not take it back
        self._secret = os.urandom(sealed.NONCE_BYTES)
        self._setpoints: Any = None  # tags of the key in use, before their message
        self._answers: Any = None

    @property
    def is_signed(self) -> bool:
        """Whether a session was ever in use."""
        return self._session != b""

    def adopt(self, admitted: Admitted) -> None:
        """Take frames of this session, and of no other key, from here on."""
        self._session, key, self._ends_ns = admitted
        self._setpoints, self._answers = sealed.hasher(key, sealed.SETPOINT), sealed.hasher(key, sealed.ANSWER)
        self._highest = -1
        self._secret = os.urandom(sealed.NONCE_BYTES)  # the key in use before will never be given again
        self.follow()  # the secrets may have changed since it was admitted, in another thread

    def follow(self) -> None:
        """Take no more frames of the session in use where it was revoked."""
        if self._session in self._gate.masters.revoked:
            self._ends_ns = 0

    def answer(self, data: bytes, arrival_ns: int, active: Active | None, overloaded: bool = False) -> bytes | None:
        """Bytes to publish for what arrived, or None: no answer."""
        if data[:4] != sealed.MAGIC:
            return self._answer_unsigned(data, arrival_ns, active, overloaded)
        # The next setpoint of the session in use, as nearly all are, in as few steps as possible: between two setpoints the
        # caches go cold, and every further call costs a microsecond.
        signed, session = data[: -sealed.TAG_BYTES], self._session
        if signed[-sealed.SESSION_BYTES :] == session:
            state = self._setpoints.copy()
            state.update(signed)
            if compare_digest(state.digest(), data[-sealed.TAG_BYTES :]):
                seq = from_bytes(data[SEQ], "little")
                if seq > self._highest and arrival_ns <= self._ends_ns:
                    self._highest = seq
                    plain = sealed.PLAIN + signed[4 : -sealed.SESSION_BYTES]
                    answer = self.stream.answer(plain, arrival_ns, active, overloaded)
                    if answer is None:
                        return None
                    out = sealed.MAGIC + answer[4:] + session
                    state = self._answers.copy()
                    state.update(out)
                    return out + bytes(state.digest())
        return self._full_path(data, arrival_ns, active, overloaded)

    def _full_path(self, data: bytes, arrival_ns: int, active: Active | None, overloaded: bool) -> bytes | None:
        if len(data) < sealed.HEADER + sealed.TRAILER:
            self._gate.dropped["forged"] += 1
            return None
        if not self._authentic(data):
            admitted = self._gate.admit(self._address, data, self._session, self._secret)
            if not isinstance(admitted, Admitted):
                return admitted
            self.adopt(admitted)
        return self._seal(self._follow(data, arrival_ns, active, overloaded))

    def _authentic(self, data: bytes) -> bool:
        if data[-sealed.TRAILER : -sealed.TAG_BYTES] != self._session:
            return False
        tag = self._setpoints.copy()
        tag.update(data[: -sealed.TAG_BYTES])
        return compare_digest(tag.digest(), data[-sealed.TAG_BYTES :])

    def _follow(self, data: bytes, arrival_ns: int, active: Active | None, overloaded: bool) -> bytes | None:
        plain = sealed.strip_signature(data)
        seq = int.from_bytes(data[SEQ], "little")
        if seq <= self._highest:
            self.replayed += 1
            return self._refuse(plain, Status.SEQ_BACK, arrival_ns)
        if arrival_ns > self._ends_ns:
            return self._refuse(plain, Status.SESSION_EXPIRED, arrival_ns)
        self._highest = seq
        return self.stream.answer(plain, arrival_ns, active, overloaded)

    def _refuse(self, plain: bytes, status: Status, arrival_ns: int) -> bytes:
        spent = self.stream.counters.count(status, arrival_ns)
        return wire.encode_refusal(wire.decode_header(plain), status, processing_ns=spent)

    def _seal(self, answer: bytes | None) -> bytes | None:
        if answer is None:
            return None
        data = sealed.MAGIC + answer[4:] + self._session
        tag = self._answers.copy()
        tag.update(data)
        return data + bytes(tag.digest())

    def _answer_unsigned(self, data: bytes, arrival_ns: int, active: Active | None, overloaded: bool) -> bytes | None:
        busy = self.is_signed and arrival_ns - self.stream.seen_ns < self.stream.rules.idle_ns
        if self._gate.unsigned and not busy:
            return self.stream.answer(data, arrival_ns, active, overloaded)
        self._gate.dropped["unsigned"] += 1
        return unsigned_refusal(data)


@dataclass
class Served:
    """A stream with its way out."""

    robot: str
    stream: Stream
    guard: Guard
    publisher: zenoh.Publisher
    status_key: str
    key: zenoh.KeyExpr
    verdict: int = -1  # on the last setpoint
    reported: tuple[int, int] = (-1, -1)
    follower: Served | None = None  # whose setpoint came after the last one of this stream

    def in_use(self, arrival_ns: int, rules: Rules) -> bool:
        """Whether a controller depends on it: more than one good setpoint, and not long ago."""
        return self.stream.good > 1 and arrival_ns - self.stream.seen_ns < rules.idle_ns


class Slots:
    """Streams by the key of their setpoints; a new dictionary with every change, because the housekeeping reads it too."""

    def __init__(self, session: zenoh.Session, rules: Rules, gate: Gate) -> None:
        self.served: dict[str, Served] = {}
        self._session = session
        self._rules = rules
        self._gate = gate

    def allocate_slot(self, key: str, names: tuple[str, str, str], arrival_ns: int) -> Served | None:
        """A slot for a stream (``names`` of its robot, answers and status), or None when all are in use."""
        robot, out, status = names
        if len(self.served) >= self._rules.slots and not self._free_slots(arrival_ns):
            return None
        publisher = self._session.declare_publisher(
            out,
            encoding=zenoh.Encoding(ENCODING),
            priority=zenoh.Priority.REAL_TIME,
            congestion_control=zenoh.CongestionControl.DROP,
            express=False,  # express with DROP loses samples in bursts and is no faster
        )
        # Once declared to the peers, the key travels as a number. Otherwise every setpoint carries its text, and a
        # subscription with wildcards is looked up again: 10 to 25 µs a round trip.
        declared = self._session.declare_keyexpr(key)
        stream = Stream(self._rules)
        guard = Guard(self._gate, address_from_key(key), stream)
        served = Served(robot, stream, guard, publisher, status, declared)
        self.served = {**self.served, key: served}
        return served

    def _free_slots(self, arrival_ns: int) -> bool:
        """Take back the slots of the idle ones, and of the rest that are not in use those good the longest time ago."""
        free = [(s.stream.seen_ns, key) for key, s in self.served.items() if not s.in_use(arrival_ns, self._rules)]
        free.sort()
        # Half of them at once: to look through all the slots for every new name would hold up the others.
        gone = {key: self.served[key] for _, key in free[: (len(free) + 1) // 2]}
        self.served = {key: served for key, served in self.served.items() if key not in gone}
        for served in self.served.values():
            served.follower = None  # it may be one that is gone
        if gone:
            self._gate.forget()
        for served in gone.values():
            served.follower = None
            served.publisher.undeclare()  # type: ignore[no-untyped-call]
            self._session.undeclare(served.key)
        return bool(gone)


def parse_setpoint_key(key: str) -> tuple[str, str, str] | None:
    """Robot, key of the answers and key of the status that belong to a key of setpoints; None when it is not one."""
    parts = key.split("/")
    if len(parts) != 7:
        return None
    try:
        names = endpoints.RobotKeys(parts[2], parts[3])
        return parts[3], names.stream(parts[5], "out"), names.stream(parts[5], "status")
    except ValueError:
        return None


def address_from_key(key: str) -> Address:
    """Site, robot and stream of a key of setpoints."""
    parts = key.split("/")
    return Address(parts[2], parts[3], parts[5])


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
