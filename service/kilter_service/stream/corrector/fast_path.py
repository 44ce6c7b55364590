"""The fast path of a stream: a plain setpoint from bytes to bytes in one compiled call.

Nearly every frame is the next in order, on time and good. Between two setpoints at 1 kHz the processor's caches go
cold, so every line of Python costs several times what a loop would show: an answer takes 19 µs on this path and 38 µs on
the full one (`Stream.answer` in stream.py), of which the correction itself is 2 µs warm and 8 µs cold. Whatever is not plain
is declined untouched, and a test holds both paths to the same answers.

A frame is a row of 8-byte words, little-endian like every machine numba compiles for: the first holds magic, kind,
joints and flags, then come sequence, time sent and time to apply (service/kilter_service/stream/corrector/wire.py).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from kilter_core import correct as core_correct
from kilter_core.arm import EXACT, KernelCache, compile_kernel
from kilter_core.correct import COLUMNS, REMOVED, Track, correct_setpoint
from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.session import Rules
from kilter_service.stream.corrector.wire import Clock, Flag, Kind, Status

# words of a stream's memory: its clock, what it answers with, what it has counted, the frames
SEQ, TRANSIT, SEEN, SENT, PACE, APPLIED, ANSWERED = range(7)
MOST_AGE, SET_BACK, DRIFT, SLACK = 7, 8, 9, 10  # the last two are floats
ROWS, JOINTS, VERSION, EPOCH, OUT_HEAD, IN_HEAD = 11, 12, 13, 14, 15, 15  # IN_HEAD + number of vectors, 1 to 3
COUNTS, REVERSING, DAMPED, SATURATED, SLOWED, SPENT, LONGEST, LAST = 19, 35, 36, 37, 38, 39, 40, 41  # COUNTS + status
# what was left of the error of the tool, nm: the most since the stream began, in the present period and in the one before
MOST_LEFT, PERIOD, LEFT_NOW, LEFT_BEFORE = 42, 43, 44, 45
OUT = 46
OUT_WORDS = 7 + wire.MAX_JOINTS
IN = OUT + OUT_WORDS
HEADER = wire.HEADER.size
BINS = IN + 4 + 3 * wire.MAX_JOINTS  # answers by the time they took: two bins an octave, the first up to 1.4 µs
MOST_BINS = 40
WORDS = BINS + MOST_BINS
PERIOD_BITS = 30  # a period is 2^30 ns, about a second
TOOL, LEFT = (
    slice(REMOVED, REMOVED + 3),
    slice(core_correct.LEFT, core_correct.LEFT + 3),
)  # of the info of a correction
LEFT_X, LEFT_Y, LEFT_Z = core_correct.LEFT, core_correct.LEFT + 1, core_correct.LEFT + 2
MOST_LEFT_NM = wire.MOST_LEFT_NM
MOST = 2**63 - 1  # what is larger than this takes the full path, where integers are unbounded
MOST_NS = 0xFFFFFFFF  # of the time that fits into an answer
IS_REVERSING, IS_DAMPED, IS_SATURATED, IS_SLOWED = map(int, (Flag.REVERSING, Flag.DAMPED, Flag.SATURATED, Flag.SLOWED))
HELD_BACK = {"reversing": REVERSING, "damped": DAMPED, "saturated": SATURATED, "slowed": SLOWED}
FLAGS = {1: 0, 2: int(Flag.QD), 3: Flag.QD | Flag.QDD}


def note_made(words: Any, made: int, left_nm: int, arrival: int) -> None:
    """Count what held a correction back; note what is left: the most of all, of this period and of the one before."""
    if made & IS_REVERSING:
        words[REVERSING] += 1
    if made & IS_DAMPED:
        words[DAMPED] += 1
    if made & IS_SATURATED:
        words[SATURATED] += 1
    if made & IS_SLOWED:
        words[SLOWED] += 1
    period = arrival >> PERIOD_BITS
    if period != words[PERIOD]:
        words[LEFT_BEFORE] = words[LEFT_NOW] if period == words[PERIOD] + 1 else 0
        words[PERIOD], words[LEFT_NOW] = period, 0
    words[LEFT_NOW] = max(words[LEFT_NOW], left_nm)
    words[MOST_LEFT] = max(words[MOST_LEFT], left_nm)


_note_made = compile_kernel(**EXACT)(note_made)


def _compile_answer() -> Any:
    @compile_kernel(**EXACT)
    def answer(  # type: ignore[no-untyped-def]
        memory, words, data, arrival
    ):
        """Answer the frame ``data`` and return 0; anything else has touched nothing but the count."""
        spent = words[OUT + 6] & MOST_NS  # of the answer before: it was known only after that was made
        words[SPENT] += spent
        words[LONGEST] = max(words[LONGEST], spent)
        if spent > 0:
            words[BINS + min(max(int(2.0 * math.log2(spent * 1e-3)), 0), MOST_BINS - 1)] += 1
        words[OUT + 6] = 0
        n, size = words[JOINTS], len(data)
        width = (size - HEADER) // (8 * n)
        if not 1 <= width <= 3 or size != HEADER + 8 * n * width:
            return -1
        bytes_of, numbers = words.view(np.uint8), words.view(np.float64)
        for i in range(size):
            bytes_of[8 * IN + i] = data[i]
        seq, sent, apply = words[IN + 1], words[IN + 2], words[IN + 3]
        if words[IN] != words[IN_HEAD + width] or seq != words[SEQ] + 1:
            return -1
        if not (0 <= sent < MOST and 0 <= apply < MOST) or words[SENT] - sent > words[SET_BACK]:
            return -1
        transit = arrival - sent
        least = min(transit, words[TRANSIT] + int((arrival - words[SEEN]) * numbers[DRIFT]))
        if transit - least > words[MOST_AGE]:
            return -1
        at = apply if apply != 0 else sent
        passed = max(0.0, (arrival - words[ANSWERED]) * 1e-9)
        step = (at - words[APPLIED]) * 1e-9
        dt = passed if step < 0.0 else min(step, passed + numbers[SLACK])
        rows, program_rows = memory.shape[0], words[ROWS]
        info = memory[rows - 1]
        status = correct_setpoint(
            memory[:program_rows],
            memory[program_rows : rows - n - 3],
            memory[rows - n - 3 : rows - 2],
            numbers[IN + 4 : IN + 4 + width * n],
            width,
            dt,
            numbers[OUT + 7 : OUT + 7 + n],
            info,
        )
        if status != 0:
            # A refused setpoint leaves no trace in the track: it is refused again, and the answer says so.
            return status
        words[PACE] = min(max(0, sent - words[SENT]), max(0, arrival - words[SEEN]))
        words[SEQ], words[TRANSIT], words[SEEN], words[SENT] = seq, least, arrival, sent
        words[APPLIED], words[ANSWERED] = at, arrival
        made = int(info[0])
        words[COUNTS] += 1
        words[LAST] = 0
        left = math.sqrt(info[LEFT_X] * info[LEFT_X] + info[LEFT_Y] * info[LEFT_Y] + info[LEFT_Z] * info[LEFT_Z])
        left_nm = int(min(1e9 * left + 0.5, MOST_LEFT_NM))
        _note_made(words, made, left_nm, arrival)
        words[OUT + 6] = left_nm << 32  # the time spent comes into the lower half when it is known
        words[OUT] = words[OUT_HEAD] | (made << 48)
        words[OUT + 1], words[OUT + 2], words[OUT + 3] = seq, sent, apply
        words[OUT + 4], words[OUT + 5] = words[VERSION], words[EPOCH]
        return 0

    return answer


_answer = _compile_answer()


def is_fast_path_compiled() -> bool:
    """Whether the fast path of these sources lies compiled on this machine; nothing is compiled to find out."""
    place = getattr(_answer, "_cache", None)
    return isinstance(place, KernelCache) and place.is_on_disk


@cache
def _entry() -> Callable[[Any, Any, bytes, int], int]:
    # numba looks at the types of the arguments before every call; here they never change, and the call behind that
    # look saves 0.25 µs warm and 3 µs cold.
    assert _answer(np.zeros((8, COLUMNS)), np.ones(WORDS, dtype=np.int64), b"", 0) != 0
    entry: Callable[[Any, Any, bytes, int], int] = _answer.compile(_answer.signatures[0])
    return entry


def latency_bin(spent_ns: int) -> int:
    """Bin of an answer that took so long; bin k begins at :func:`bin_edges_us` [k]."""
    return min(max(int(2.0 * math.log2(spent_ns * 1e-3)), 0), MOST_BINS - 1)


def bin_edges_us() -> list[float]:
    """Where each bin begins, µs; the first takes everything below the second, the last everything above."""
    return [2.0 ** (0.5 * k) if k else 0.0 for k in range(MOST_BINS)]


class Counters:
    """What a stream has done, for its status document; the numbers are in the memory of its fast path."""

    def __init__(self, words: Any) -> None:
        self._words = words
        self._words[LAST] = -1

    @property
    def by_status(self) -> list[int]:
        """Answers by status."""
        return [int(count) for count in self._words[COUNTS : COUNTS + len(Status)]]

    @property
    def good(self) -> int:
        """Answers that carried numbers."""
        return int(self._words[COUNTS])

    @property
    def held_back_counts(self) -> dict[str, int]:
        """Answers whose correction was held back, by what held it."""
        return {name: int(self._words[word]) for name, word in HELD_BACK.items()}

    @property
    def most_left_nm(self) -> tuple[int, int]:
        """The most that was left of the error of the tool: lately, that is, in one to two periods; since the stream began."""
        words = self._words
        since = (time.monotonic_ns() >> PERIOD_BITS) - int(words[PERIOD])
        lately = max(int(words[LEFT_NOW]) if since < 2 else 0, int(words[LEFT_BEFORE]) if since < 1 else 0)
        return lately, int(words[MOST_LEFT])

    @property
    def last_status(self) -> int:
        """Status of the last answer, -1 before the first."""
        return int(self._words[LAST])

    def count(self, status: int, arrival_ns: int) -> int:
        """Count an answer of the full path; returns the time spent on it, ns, as it fits into the frame."""
        spent = max(0, min(time.monotonic_ns() - arrival_ns, MOST_NS))
        self._words[COUNTS + status] += 1
        self._words[SPENT] += spent
        self._words[LONGEST] = max(self._words[LONGEST], spent)
        if spent > 0:
            self._words[BINS + latency_bin(spent)] += 1
        self._words[LAST] = status
        return spent

    @property
    def by_time(self) -> list[int]:
        """Answers by the time they took inside the corrector, one number for each bin."""
        bins = [int(count) for count in self._words[BINS : BINS + MOST_BINS]]
        pending = int(self._words[OUT + 6]) & MOST_NS
        if pending:
            bins[latency_bin(pending)] += 1
        return bins

    def count_made(self, flags: int, left_nm: int, arrival_ns: int) -> None:
        """Count how an answer of the full path was made, and what was left."""
        note_made(self._words, flags, left_nm, arrival_ns)

    def document(self) -> dict[str, Any]:
        """Counts by name; times are those inside the corrector, lengths what was left of the error of the tool."""
        lately, most = self.most_left_nm
        counts, last, pending = self.by_status, self.last_status, int(self._words[OUT + 6]) & MOST_NS
        answered = sum(counts)
        mean = (int(self._words[SPENT]) + pending) / answered / 1000.0 if answered else None
        return {
            "received": answered,
            "counters": {status.name: counts[status] for status in Status},
            **self.held_back_counts,
            "left_mm": {"lately": round(lately * 1e-6, 6), "max": round(most * 1e-6, 6)},
            "last_status": Status(last).name if last >= 0 else None,
            "processing_us": {
                "mean": None if mean is None else round(mean, 2),
                "max": round(max(int(self._words[LONGEST]), pending) / 1000.0, 2),
            },
        }


class Answered(NamedTuple):
    """A setpoint that was corrected, for people to look at: arrays as bytes, which no later setpoint changes."""

    arrival_ns: int  # monotonic clock
    flags: int
    wanted: bytes  # float64, rad or m
    corrected: bytes
    tool: bytes  # by how much the tool would be off without the correction: x, y, z, m
    left_nm: int  # and by how much it is with it


class FastPath:
    """Memory of one stream's plain setpoints.

    ``answer(data, arrival_ns)`` gives the answer to a plain setpoint that is the next in order and good, and None for
    any other, which changed nothing. The stream's clock is handed over by :meth:`adopt_clock` and back by :meth:`give`.
    """

    def __init__(self, rules: Rules) -> None:
        self._words = np.zeros(WORDS, dtype=np.int64)
        self._words[[MOST_AGE, SET_BACK]] = rules.max_age_ns, rules.set_back_ns
        self._words.view(np.float64)[[DRIFT, SLACK]] = rules.clock_drift, rules.time_slack_s
        self._info: Any = None
        self.answer: Callable[[bytes, int], bytes | None] = lambda data, arrival_ns: None
        self.counters = Counters(self._words)

    def follow(self, track: Track, active: Active) -> None:
        """Answer with this version from now on, in the memory of this track."""
        n = track.program.n_joints
        self._words[ROWS], self._words[JOINTS] = len(track.program.array), n
        head = int.from_bytes(wire.MAGIC, "little") | Kind.POINT << 32 | n << 40
        for width, flags in FLAGS.items():
            self._words[IN_HEAD + width] = head | flags << 48
        self._info = track.info
        self.answer = self._bind(track.memory, n)
        self._words[OUT_HEAD] = head
        self._words[VERSION] = np.uint64(active.number).astype(np.int64)
        self._words[EPOCH] = active.epoch

    def adopt_clock(self, clock: Clock) -> bool:
        """Take the clock over; False when it does not fit, and the stream has to keep to its full path."""
        if clock.transit_ns is None:
            return False
        words = (
            clock.seq,
            clock.transit_ns,
            clock.seen_ns,
            clock.sent_ns,
            clock.pace_ns,
            clock.applied_ns,
            clock.answered_ns,
        )
        if not all(abs(word) < MOST for word in words):
            return False
        self._words[SEQ : ANSWERED + 1] = words
        return True

    @property
    def seen_ns(self) -> int:
        """When the last plain setpoint arrived."""
        return int(self._words[SEEN])

    def last_answer(self) -> Answered | None:
        """What it answered last, for another thread; None when it has declined a setpoint since.

        numpy copies so few words without a pause for other threads, so wanted and corrected are of one setpoint.
        """
        words = self._words.copy()
        if words[IN + 1] != words[OUT + 1] or not words[OUT] or self._info is None:
            return None
        joints = int(words[OUT]) >> 40 & 0xFF
        wanted, corrected = words[IN + 4 : IN + 4 + joints], words[OUT + 7 : OUT + 7 + joints]
        flags = int(words[OUT]) >> 48 & 0xFFFF
        tool, left_nm = self._info[TOOL].tobytes(), int(words[OUT + 6]) >> 32
        return Answered(int(words[SEEN]), flags, wanted.tobytes(), corrected.tobytes(), tool, left_nm)

    def give(self, clock: Clock) -> None:
        """Write into ``clock`` the present state of the stream."""
        (
            clock.seq,
            clock.transit_ns,
            clock.seen_ns,
            clock.sent_ns,
            clock.pace_ns,
            clock.applied_ns,
            clock.answered_ns,
        ) = (int(word) for word in self._words[SEQ : ANSWERED + 1])

    def _bind(self, memory: Any, joints: int) -> Callable[[bytes, int], bytes | None]:
        # A function with everything at hand: each look into an object costs a tenth of a microsecond, cold.
        words, compiled, now = self._words, _entry(), time.monotonic_ns
        out = words.data.cast("B")[8 * OUT : 8 * (OUT + 7 + joints)]
        spent = out[48:52].cast("I")  # processing ns, as wire.VERDICT has it

        def answer(data: bytes, arrival_ns: int) -> bytes | None:
            if compiled(memory, words, data, arrival_ns):
                return None
            took = now() - arrival_ns
            spent[0] = took if 0 <= took <= MOST_NS else 0 if took < 0 else MOST_NS
            return out.tobytes()

        return answer


def warm_up() -> None:
    """Compile the fast path, or load it from the cache."""
    _entry()
