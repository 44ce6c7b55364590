"""The signed side of one stream: opens frames, keeps their sequence, signs the answers."""

from __future__ import annotations

import os
from hmac import compare_digest
from typing import Any

from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.gate import Address, Admitted, Gate, unsigned_refusal
from kilter_service.stream.corrector.stream import Stream
from kilter_service.stream.corrector.wire import Status
from kilter_service.stream.signing import sealed

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
