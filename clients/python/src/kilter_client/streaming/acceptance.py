"""Which answers a stream accepts: only echoes of what it sent, with corrections that are not too large.

Everybody who reaches the corrector's network can publish on the key of the answers. Where frames are signed, only an answer
signed with the key in use comes as far as this. The sequence number and the time of sending are drawn at random, so only
somebody who reads the setpoints can echo them. Whoever does that on an unsigned stream can still only move the arm within
the largest correction, and no faster than :mod:`kilter_client.streaming.held_correction` allows.
"""

from __future__ import annotations

import os
import secrets
import struct
import time
from collections.abc import Callable, Sequence
from operator import le, sub

from kilter_client.signing import Signer
from kilter_client.streaming.accepted_versions import InUse
from kilter_client.streaming.frames import CHUNK, POINT, Answer, decode, encode
from kilter_client.streaming.setpoint import Statistics

RANDOM = 2**20 - 1  # ns of the time of sending: about a millisecond, while a setpoint may be 50 ms old
DRAWS = struct.Struct("<128I")
WHOLE = 2**64 - 1


class Acceptance:
    """Makes the frames of one stream and judges the answers to the last one."""

    def __init__(
        self,
        statistics: Statistics,
        in_use: InUse,
        version: int | None,
        ask: Callable[[], None],
        signer: Signer | None = None,
    ) -> None:
        self._signer = signer
        self._statistics = statistics
        self._in_use = in_use
        self._version = version
        self._ask = ask  # which version is active
        self._first = self._seq = secrets.randbits(62)
        self._zero_ns = secrets.randbits(61)  # the clock of the frames begins anywhere
        self._drawn: list[int] = []
        self.echo = b""  # what an answer to the last setpoint repeats
        self._shape = (POINT, 0, 0, 0)  # kind, joints, points, step of the answer
        self._wanted: Sequence[float] = ()

    def frame(
        self,
        values: Sequence[float],
        wanted: Sequence[float],
        joints: int,
        flags: int,
        t_apply_ns: int,
        points: int | None = None,
        step_ns: int = 0,
    ) -> tuple[bytes, int]:
        """Bytes of the next setpoint (``wanted`` are its positions), and when it was made, monotonic ns."""
        self._seq += 1
        now = time.monotonic_ns()
        if not self._drawn:
            self._drawn = list(DRAWS.unpack(os.urandom(DRAWS.size)))  # many at once: each call takes a microsecond
        sent = (now + self._zero_ns) & ~RANDOM | self._drawn.pop() & RANDOM
        data = encode(
            values,
            joints=joints,
            seq=self._seq,
            t_send_ns=sent,
            t_apply_ns=((t_apply_ns or now) + self._zero_ns) & WHOLE,
            flags=flags,
            version=self._version,
            points=points,
            step_ns=step_ns,
        )
        self._wanted = wanted
        self._shape = (POINT if points is None else CHUNK, joints, points or 1, step_ns)
        self.echo = data[8:32]
        return (data if self._signer is None else self._signer.sign_frame(data)), now

    def echoes(self, data: bytes) -> bool:
        """Whether bytes repeat sequence and times of the last setpoint; else they are counted."""
        if data[8:32] == self.echo:
            return True
        if len(data) < 32:
            self._statistics.malformed += 1
        elif self._first < int.from_bytes(data[8:16], "little") < self._seq:
            self._statistics.late += 1
        else:
            self._statistics.foreign += 1
        return False

    def judge(self, data: bytes) -> Answer | None:
        """The answer to the setpoint just sent, or None for anything else, which is counted."""
        if not self.echoes(data):
            return None
        answer = decode(data)
        if answer is None or answer.kind != self._shape[0]:
            self._statistics.malformed += 1
        elif answer.status != "OK":
            return answer
        elif (answer.kind, answer.joints, answer.points, answer.step_ns) != self._shape:
            self._statistics.malformed += 1
        elif (answer.epoch, answer.version) not in self._in_use.known or self._version not in (None, answer.version):
            self._statistics.unknown_epoch += 1
            self._ask()
        elif not self._small(answer.q):
            self._statistics.too_large += 1
        else:
            return answer
        return None

    def _small(self, q: Sequence[float]) -> bool:
        limits = self._in_use.limits
        if len(limits) != self._shape[1]:
            return False
        if self._shape[2] > 1:
            limits *= self._shape[2]
        # What is not a number is not less, either. Without a loop of its own: it runs a thousand times a second.
        return all(map(le, map(abs, map(sub, q, self._wanted)), limits))
