"""The versions whose answers a stream accepts.

Anybody on the network can publish an announcement, so one is never believed by itself: it may only *add* a version whose
answers are taken, and makes the stream ask. What the stream knew stays until an answer to its own question replaces it.

Which answers a stream accepts: only echoes of what it sent, with corrections that are not too large.

Everybody who reaches the corrector's network can publish on the key of the answers. Where frames are signed, only an answer
signed with the key in use comes as far as this. The sequence number and the time of sending are drawn at random, so only
somebody who reads the setpoints can echo them. Whoever does that on an unsigned stream can still only move the arm within
the largest correction, and no faster than :mod:`kilter_client.streaming.held_correction` allows.
"""

from __future__ import annotations

import json
import math
import os
import secrets
import struct
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from operator import le, mul, sub
from typing import Any

from kilter_client.signing import Signer
from kilter_client.streaming.frames import CHUNK, POINT, Answer, Statistics, decode, encode

MOST_BYTES = 16_384
MOST_REPLIES = 16
MOTION_SHARE = 0.1  # of its motion that an arm's correction may change by besides, where its version states no rate
ROUNDING = 1e-9  # rad or m: the corrector bounds its correction before it adds it

Pair = tuple[int, int]  # epoch and number of a version, as they stand in every answer


def read(payload: bytes) -> dict[str, Any] | None:
    """An announcement as its document; ``{}`` when it says that nothing is active, None when it is none."""
    if len(payload) > MOST_BYTES:
        return None
    try:
        document = json.loads(payload)
        if document.get("epoch", 0) is None:
            return {}
        epoch, number, joints = document["epoch"], int(document["version"], 16), document["joints"]
        good = type(epoch) is int and 0 <= epoch < 2**32 and 0 <= number < 2**64
        good = good and type(joints) is int and 0 < joints <= 16
        for largest in (document["largest_deg"], document["largest_mm"]):
            good = good and type(largest) in (int, float) and 0.0 < float(largest) < math.inf
        return document if good and isinstance(document["version_id"], str) else None
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
        return None


def _positive(value: object) -> float | None:
    """A number of an announcement that is finite and not negative; None for anything else."""
    good = type(value) in (int, float) and 0.0 <= float(value) < math.inf  # type: ignore[arg-type]
    return float(value) if good else None  # type: ignore[arg-type]


def epoch_and_version(document: dict[str, Any]) -> Pair:
    """Epoch and version number of an announcement."""
    return document["epoch"], int(document["version"], 16)


class InUse:
    """Versions in use, from announcements and from answers to the question which one is active.

    ``largest_rad`` and ``largest_m`` are the caller's ceiling, in ``quickest_s`` at the least; a version's own limits and
    rates count where they are less.
    """

    def __init__(self, largest_rad: float, largest_m: float, quickest_s: float = 0.2) -> None:
        self._ceiling, self._quickest_s = (largest_rad, largest_m), quickest_s
        self._kinds: list[str] = []  # of the joints; they stay what they were at first, for a robot stays what it is
        self._announced: deque[Pair] = deque(maxlen=8)
        self._confirmed: tuple[Pair, ...] = ()
        self.active: dict[str, Any] | None = None
        self.known: frozenset[Pair] = frozenset()
        self.limits: tuple[float, ...] = ()  # largest correction of each joint, rad or m
        self.rates: tuple[float, ...] = ()  # how fast that of each joint may change, rad/s or m/s
        self.motion_share = MOTION_SHARE
        self._levers: tuple[float, ...] = ()  # by how much a joint moves the tool at most, mm for each rad or m

    def announce(self, payload: bytes) -> None:
        """Hear an announcement: answers of its version are taken from here on, beside those known."""
        document = read(payload)
        if document and epoch_and_version(document) not in self._announced:
            self._announced.append(epoch_and_version(document))
            self._renew()

    def confirm(self, replies: Iterable[bytes]) -> bool:
        """Take the answers to the stream's own question over; False when there were none."""
        read_ones = [document for reply in replies if (document := read(reply)) is not None]
        documents = [document for document in read_ones if document and self._fits(document)]
        if documents:
            self._follow(documents)
        elif read_ones and not any(read_ones):  # somebody says that nothing is active, and nobody says otherwise
            self.active, self._confirmed = None, ()
            self._announced.clear()
            self._renew()
        return bool(read_ones)

    def _follow(self, documents: list[dict[str, Any]]) -> None:
        # The version before stays known: its last answers are on their way.
        before = (epoch_and_version(self.active),) if self.active else ()
        self._confirmed = (*before, *map(epoch_and_version, documents))
        same = [document for document in documents if (epoch_and_version(document),) == before]
        self.active = (same or sorted(documents, key=epoch_and_version))[-1]
        self.limits = self._limits(documents)
        self.rates = self._rates(documents)
        stated = [_positive(self.active.get(name)) is not None for name in ("rate_deg_s", "rate_mm_s")]
        self.motion_share = 0.0 if any(stated) else MOTION_SHARE
        self._levers = self._lever_lengths(self.active)
        self._renew()

    def _fits(self, document: dict[str, Any]) -> bool:
        return not self._kinds or document["joints"] == len(self._kinds)

    def _limits(self, documents: list[dict[str, Any]]) -> tuple[float, ...]:
        """Of each joint the least of the ceiling and what is announced; with several answers the most generous one."""
        assert self.active is not None
        radians = min(self._ceiling[0], max(math.radians(document["largest_deg"]) for document in documents))
        metres = min(self._ceiling[1], max(document["largest_mm"] / 1000.0 for document in documents))
        if not self._kinds:
            kinds, joints = self.active.get("joint_kinds"), self.active["joints"]
            self._kinds = kinds if isinstance(kinds, list) and len(kinds) == joints else ["revolute"] * joints
        return tuple((metres if kind == "prismatic" else radians) + ROUNDING for kind in self._kinds)

    def _rates(self, documents: list[dict[str, Any]]) -> tuple[float, ...]:
        """Of each joint the least of the ceiling and the rate announced; where none is, the largest in the quickest time."""
        radians = [math.radians(rate) for d in documents if (rate := _positive(d.get("rate_deg_s"))) is not None]
        metres = [rate / 1000.0 for d in documents if (rate := _positive(d.get("rate_mm_s"))) is not None]
        found = []
        for kind, limit in zip(self._kinds, self.limits, strict=True):
            stated, ceiling = (metres, self._ceiling[1]) if kind == "prismatic" else (radians, self._ceiling[0])
            found.append(min(max(stated), ceiling / self._quickest_s) if stated else limit / self._quickest_s)
        return tuple(found)

    def _lever_lengths(self, document: dict[str, Any]) -> tuple[float, ...]:
        levers = document.get("levers_mm")
        if not isinstance(levers, list) or len(levers) != len(self._kinds):
            return ()
        read_ones = [_positive(lever) for lever in levers]
        if any(lever is None for lever in read_ones):
            return ()
        scales = [1000.0 if kind == "prismatic" else 1.0 for kind in self._kinds]
        return tuple(lever * scale for lever, scale in zip(read_ones, scales, strict=True) if lever is not None)

    def at_tool_mm(self, lag: Sequence[float]) -> float | None:
        """How far the tool is off at most when the joints are off by ``lag``, rad or m; None when that cannot be told."""
        return sum(map(mul, map(abs, lag), self._levers)) if self._levers else None

    def _renew(self) -> None:
        self.known = frozenset((*self._confirmed, *self._announced))


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
