"""Which frame of a stream comes next, and how old it is; docs/reference/stream.md states these rules.

Clocks of two machines are never compared. The smallest difference between arrival and sending seen so far counts
as the transit time, and the age of a frame is what exceeds that. One frame never decides: one that does not fit is refused and
leaves the stream as it is, until a second frame continues from it.
"""

from __future__ import annotations

from dataclasses import dataclass

from kilter_service.stream.corrector.session import Rules
from kilter_service.stream.corrector.wire import Status


@dataclass(frozen=True)
class Late:
    """Frames in a row that are too old: when the run began, with which transit time, and its last sequence number."""

    since_ns: int
    transit_ns: int
    seq: int


@dataclass
class Clock:
    """State of a stream: its last sequence number, and times in ns; ``transit_ns`` is the shortest transit time seen."""

    seq: int = -1
    transit_ns: int | None = None
    seen_ns: int = 0  # arrival of the last frame in order
    sent_ns: int = 0  # when that was sent
    pace_ns: int = 0  # between it and the one before
    applied_ns: int = 0
    answered_ns: int = 0
    rival: tuple[int, int] | None = None  # a sequence number too far ahead, and the one it came after
    late: Late | None = None

    def follows(self, seq: int) -> bool:
        """Whether ``seq`` is the next in order, or goes on from one that was refused for being too far ahead."""
        return self.seq < 0 or seq == self.seq + 1 or self.rival == (seq - 1, self.seq)

    def refuse(self, seq: int, arrival_ns: int, sent_ns: int, overloaded: bool, rules: Rules) -> Status:
        """Verdict on a frame out of order. The stream stays where it is; the next frame may prove this one right."""
        if seq <= self.seq:
            return Status.SEQ_BACK
        self.rival = (seq, self.seq)
        if self.age(arrival_ns, sent_ns, rules)[0] > rules.max_age_ns:
            return Status.STALE
        return Status.OVERLOAD if overloaded else Status.SEQ_GAP

    def age(self, arrival_ns: int, sent_ns: int, rules: Rules) -> tuple[int, int]:
        """How old a frame is, and the transit time that follows from it."""
        transit = arrival_ns - sent_ns
        if self.transit_ns is None:
            return 0, transit
        if self.sent_ns - sent_ns > rules.set_back_ns:
            # Frames in order are sent in order, so the clock was set back. Only the time that really passed tells how much
            # older this frame can be than the one before: a burst after a hang stays old.
            before = self.seen_ns - self.sent_ns - self.transit_ns
            age = max(0, before + arrival_ns - self.seen_ns - self.pace_ns)
            return age, transit - age
        least = min(transit, self.transit_ns + int((arrival_ns - self.seen_ns) * rules.clock_drift))
        return transit - least, least

    def advance_to_frame(self, seq: int, arrival_ns: int, sent_ns: int, rules: Rules) -> bool:
        """Go on to a frame in order; False when it is too old."""
        age, least = self.age(arrival_ns, sent_ns, rules)
        if age > rules.max_age_ns and self._agrees(seq, arrival_ns, arrival_ns - sent_ns, rules):
            age, least = 0, arrival_ns - sent_ns
        if self.transit_ns is not None:
            self.pace_ns = min(max(0, sent_ns - self.sent_ns), max(0, arrival_ns - self.seen_ns))
        self.seq, self.transit_ns, self.seen_ns, self.sent_ns = seq, least, arrival_ns, sent_ns
        return age <= rules.max_age_ns

    def _agrees(self, seq: int, arrival_ns: int, transit_ns: int, rules: Rules) -> bool:
        """Whether late frames have kept one pace for so long that the transit time is longer now; in a burst they catch up."""
        late = self.late
        if late is None or late.seq + 1 != seq or abs(transit_ns - late.transit_ns) > rules.agree_ns:
            late = Late(arrival_ns, transit_ns, seq)
        self.late = Late(late.since_ns, late.transit_ns, seq)
        return arrival_ns - late.since_ns >= rules.agree_for_ns

    def elapsed_s(self, at_ns: int, arrival_ns: int, slack_s: float) -> float:
        """Time since the last answered setpoint on the controller's clock, bounded by the time that really passed.

        A clock that was set back says nothing: then the time that passed counts.
        """
        passed = max(0.0, (arrival_ns - self.answered_ns) * 1e-9)
        step = (at_ns - self.applied_ns) * 1e-9
        return passed if step < 0.0 else min(step, passed + slack_s)
