"""The loop of bridges whose controller asks over UDP and waits for the answer: RSI, EGM."""

from __future__ import annotations

import contextlib
import gc
import math
import select
import socket
import struct
import sys
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from kilter_client.bridges.correction import TELL_S, Line

if TYPE_CHECKING:
    from kilter_client.bridges.correction import Correction

# A distribution is kept up to date answer by answer: to sort 20 000 times takes 4 ms, a whole cycle of a KUKA controller.
LAST = 20_000  # answers that count
LEAST_S, OCTAVES, STEPS = 1e-6, 22, 32  # from 1 us to 4 s, in steps of 2.2 %


class AnswerTimes:
    """The last answers by how long they took, and the longest of all."""

    def __init__(self, last: int = LAST) -> None:
        self._places: deque[int] = deque()
        self._last = last
        self._counts = [0] * (OCTAVES * STEPS)
        self.longest_s = 0.0

    def note(self, took_s: float) -> None:
        """Count an answer; the oldest one is forgotten."""
        place = int(STEPS * math.log2(max(took_s, LEAST_S) / LEAST_S))
        place = min(place, len(self._counts) - 1)
        self._counts[place] += 1
        self._places.append(place)
        if len(self._places) > self._last:
            self._counts[self._places.popleft()] -= 1
        self.longest_s = max(self.longest_s, took_s)

    def quantile_s(self, part: float) -> float | None:
        """Return the time within which this part of the answers came, to about 1 %; None before the first."""
        left = part * len(self._places)
        for place, count in enumerate(self._counts):
            left -= count
            if count and left < 0.0:
                return float(LEAST_S * 2.0 ** ((place + 0.5) / STEPS))
        return None


LARGEST_PACKET = 1500  # bytes, of which a frame of Ethernet has no more; larger ones are malformed
MOST_AHEAD = 2  # cycles by which stamps may be ahead of the time that has passed
MOST_WAITING = 64  # requests that are looked at to find the newest
# Of Linux: each packet comes with the time at which it arrived, and the system counts those that found no room.
SO_TIMESTAMPNS, SO_MEMINFO = 35, 55
_TIMESPEC, _MEMINFO = struct.Struct("qq"), struct.Struct("9I")
ROOM = 1 << 20  # bytes for packets that wait; the system may give less


@contextlib.contextmanager
def without_collections() -> Iterator[None]:
    """Let no collection of garbage interrupt a cycle: what a cycle leaves is freed by its count of references."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


class Request(NamedTuple):
    """A request of the controller: its time stamp, its joints (n,) rad or None, and how many answers it missed itself.

    ``moving``: it carries answers out. ``clock``: a second stamp, to be echoed.
    """

    stamp: int
    joints: tuple[float, ...] | None
    missed: int | None = None
    moving: bool = True
    clock: int = 0


class Wire(Protocol):
    """The messages of a controller."""

    @property
    def counts(self) -> Counter[str]:
        """What was not followed, by its name."""

    def read(self, data: bytes) -> Request | None:
        """Return a request; None when the bytes are none."""

    def cycles(self, stamps: int) -> int | None:
        """Return the cycles that are between stamps so far apart, at least one; None where that cannot be told."""

    def wanted_joints(self, request: Request, cycles: int, fresh: bool) -> Sequence[float] | None:
        """Return the wanted joints (n,) rad, ``cycles`` after the last ones; ``fresh``: the controller begins."""

    def answer(self, request: Request, offset: Sequence[float]) -> bytes:
        """Return the answer that offsets (n,) rad make; nothing where there is none."""


Address = tuple[str, int]


class Packet(NamedTuple):
    """What came, who sent it, how long it has waited for this process, s, and whether that is all of it."""

    data: bytes
    sender: Address
    waited_s: float
    whole: bool


class Loop:
    """Answers one controller.

    Args:
        port: the socket that the controller sends to.
        wire: its messages.
        correction: what offsets the joints.
        line: to the companion.
        cycle_s: so often the controller asks.
        expected: the controller's address, and its port or 0 for any; None: whoever asks first is the controller.
        gone_after_s: of silence, after which the controller has stopped by itself and begins without offsets. A controller
            that asks already when the bridge starts may still hold the offsets of a bridge before this one: it gets no
            answer, so that it stops.

    """

    def __init__(
        self,
        port: socket.socket,
        wire: Wire,
        correction: Correction,
        line: Line,
        cycle_s: float,
        gone_after_s: float,
        expected: Address | None = None,
    ) -> None:
        self._port, self._wire, self._correction, self._line = port, wire, correction, line
        self._cycle_s, self._gone_after_s = cycle_s, gone_after_s
        self._expected = expected
        self._asked = select.poll()
        self._asked.register(port, select.POLLIN)
        self._controller: Address | None = None
        self._heard_s = self._taken_s = time.monotonic()  # the last request of any who may ask; the last that was taken
        self._read_up_to_s = self._heard_s  # whatever came before was read
        self._dropped = 0  # packets that found no room
        self._patience_s = min(TELL_S, gone_after_s / 4.0)
        self._stamp = -1
        self._passed_over = 0  # requests that waited while a newer one came, since the last answer
        self._leaving = self._was_out = False  # the latter: the controller had an answer without offsets in time
        self.counts: Counter[str] = Counter()
        self._missed: int | None = None
        self._was_late = False  # the last answer
        self._times = AnswerTimes()

    def leave(self) -> None:
        """Fade the offsets out, then end."""
        self._leaving = True

    def run(self) -> None:
        """Answer until :meth:`leave`."""
        self._port.setblocking(False)
        self._port.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, ROOM)
        if sys.platform == "linux":  # elsewhere a request counts from when it is read
            self._port.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        with without_collections():
            while not (self._leaving and (self._is_out() or self._is_unanswered(time.monotonic()))):
                self._cycle()

    def _is_out(self) -> bool:
        """Whether nothing is offset, and the controller surely knows: it may have missed the last answer."""
        return self._correction.out and (self._was_out or self._controller is None)

    def _cycle(self) -> None:
        self._asked.poll(1000 * self._patience_s)
        if sys.platform == "linux":
            self._note_dropped()
        if (newest := self._read_newest()) is not None:
            self._answer_request(*newest)
        while (packet := self._line.receive()) is not None:
            self._correction.hear(*packet)
        if self._leaving:
            self._correction.off = "the bridge is being ended"
        self._line.send_state_if_due(self.document)

    def _note_dropped(self) -> None:
        """Take packets that found no room for requests: silence is only what was seen to be silent."""
        *_, dropped = _MEMINFO.unpack(self._port.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, _MEMINFO.size))
        if dropped != self._dropped:
            self.counts["no_room"] += (dropped - self._dropped) % (1 << 32)
            self._dropped, self._heard_s = dropped, time.monotonic()

    def _receive_packet(self) -> Packet:
        """Return what came first of all that waits: whatever came before it was read."""
        data, ancillary, flags, sender = self._port.recvmsg(LARGEST_PACKET, 64)
        waited_s = 0.0
        if ancillary and len(ancillary[0][2]) == _TIMESPEC.size:
            seconds, nanoseconds = _TIMESPEC.unpack(ancillary[0][2])
            waited_s = max(0.0, time.time() - seconds - 1e-9 * nanoseconds)
            self._read_up_to_s = max(self._read_up_to_s, time.monotonic() - waited_s)
        return Packet(data, sender, waited_s, not flags & socket.MSG_TRUNC)

    def _read_newest(self) -> tuple[Request, Packet, bool] | None:
        """Return the newest request of the controller among those that wait, and whether silence was before the first of them.

        Those before it are late. Nothing of another sender is read: a stranger must not cost more than its reception.
        """
        newest = None
        for _ in range(MOST_WAITING):
            now_s = time.monotonic()
            try:
                packet = self._receive_packet()
            except BlockingIOError:
                self._read_up_to_s = now_s
                break
            except ConnectionError:  # the controller's port was closed
                continue
            if not self._may_ask(packet.sender) or (newest is not None and packet.sender != newest[1].sender):
                self.counts["other_controller"] += 1
                continue
            request = self._wire.read(packet.data) if packet.whole else None
            if request is None:
                self.counts["malformed"] += 1
                continue
            begins = self._is_silent() if newest is None else newest[2]
            self.counts["late"] += newest is not None
            self._passed_over += newest is not None
            newest, self._heard_s = (request, packet, begins), time.monotonic()
        return newest

    def _may_ask(self, sender: Address) -> bool:
        """Whether a sender is the controller, or may become it: the address named, and one at a time."""
        if self._expected is not None and (sender[0] != self._expected[0] or self._expected[1] not in (0, sender[1])):
            return False
        return self._controller is None or sender == self._controller or self._is_silent()

    def _answer_request(self, request: Request, packet: Packet, begins: bool) -> None:
        """Answer the controller's request if it is newer than the last; ``begins``: silence was before it."""
        now_s = time.monotonic()
        if begins:
            self._controller, self._stamp = packet.sender, -1
            self._correction.reset_to_zero()
        elif self._controller is None or self._is_unanswered(now_s):
            # It asked before the bridge listened, or while the bridge was held up: it must fall silent first.
            self._controller = None
            self.counts["refused"] += 1
            return
        if request.stamp > self._stamp:
            self._answer(request, packet, now_s)
        else:
            self.counts["old_stamp"] += 1

    def _answer(self, request: Request, packet: Packet, began_s: float) -> None:
        fresh = self._stamp < 0 or not request.moving
        cycles = 1 if fresh else self._elapsed_cycles(request.stamp, began_s)
        self.counts["lost"] += max(0, cycles - 1 - self._passed_over)  # no request of these cycles came
        self._passed_over = 0
        taken = fresh or self._was_taken(request.missed, cycles)
        self._was_out = taken and self._correction.out
        self._stamp, self._taken_s, self._missed = request.stamp, began_s, request.missed
        wanted = self._wire.wanted_joints(request, cycles, fresh)
        if not request.moving:
            self._correction.reset_to_zero()
        offset = self._correction.step(wanted, cycles, taken) if request.moving else self._correction.offset
        answer = self._wire.answer(request, offset)
        if answer and not self._sent(answer, packet.sender):
            return
        took_s = time.monotonic() - began_s
        self.counts["answered"] += 1
        self._was_late = packet.waited_s + took_s > self._cycle_s
        self.counts["late"] += self._was_late
        self._times.note(took_s)

    def _sent(self, answer: bytes, sender: Address) -> bool:
        """Send an answer; False where the system refuses, as to port 0: the controller goes on without it."""
        try:
            self._port.sendto(answer, sender)
        except OSError:
            self.counts["unsent"] += 1
            self._was_late = True
            return False
        return True

    def _was_taken(self, missed: int | None, cycles: int) -> bool:
        """Whether the controller had the last answer in time: by its count, which has cycles without one too, else by ours."""
        if missed is not None and self._missed is not None:
            return missed - self._missed < cycles
        return not self._was_late

    def _elapsed_cycles(self, stamp: int, now_s: float) -> int:
        """Cycles since the last request: by the controller's stamps, which do not jitter, else by the time that has passed."""
        elapsed = max(1, round((now_s - self._taken_s) / self._cycle_s))
        counted = self._wire.cycles(stamp - self._stamp)
        return elapsed if counted is None else min(counted, elapsed + MOST_AHEAD)

    def _is_unanswered(self, now_s: float) -> bool:
        """Whether no request was taken for so long that a controller has stopped."""
        return now_s - self._taken_s >= self._gone_after_s

    def _is_silent(self) -> bool:
        """Whether nobody asked for so long that a controller has stopped: by when packets came, not by when they were read."""
        return self._read_up_to_s - self._heard_s >= self._gone_after_s

    def _waits(self) -> str:
        """What it waits for, if no controller is being answered: the silence before the first one, or one that asks."""
        if self._is_silent():
            return "waiting"
        return "" if self._controller is not None else "refusing" if self.counts["refused"] else "starting"

    def document(self) -> dict[str, Any]:
        """The state, JSON-able."""
        told = self._correction.document()
        waits = self._waits()
        if waits:
            told |= {"state": waits, "why": BEFORE if waits == "refusing" else told["why"]}
        return told | {
            "controller": None if self._controller is None else "{}:{}".format(*self._controller),
            "counts": dict(self.counts + self._wire.counts),
            "controller_missed": self._missed,
            "answer_us": {
                name: None if (took_s := self._times.quantile_s(part)) is None else round(1e6 * took_s, 1)
                for name, part in (("p50", 0.5), ("p99", 0.99))
            },
            "answer_longest_us": round(1e6 * self._times.longest_s, 1),
            "cycle_s": self._cycle_s,
        }


BEFORE = (
    "a controller asked already when the bridge began to listen, and may hold offsets from before: "
    "let it stop, and start it again"
)


def radians(degrees: Sequence[float], signs: Sequence[float]) -> tuple[float, ...]:
    """Joints of a controller, deg, as the robot's, rad."""
    return tuple(math.radians(sign * value) for sign, value in zip(signs, degrees, strict=False))
