"""One stream: bytes in, bytes out, and the memory between them. It uses no zenoh, so every rule can be tested alone."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from kilter_core.correct import Track, walk_whole
from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.fast_path import LEFT, TOOL, Answered, FastPath
from kilter_service.stream.corrector.session import Rules
from kilter_service.stream.corrector.wire import Clock, Flag, Kind, Setpoints, Status


@dataclass
class FrameSequence:
    """One sequence of frames, from its start: its state, and the memory of its correction."""

    clock: Clock = field(default_factory=Clock)
    settled: bool = False
    track: Track | None = None
    active: Active | None = None


class Stream:
    """Answers the setpoints of one controller in order."""

    def __init__(self, rules: Rules | None = None) -> None:
        self.rules = rules or Rules()
        self._fast = FastPath(self.rules)
        self.counters = self._fast.counters
        self._active: Active | None = None  # what the fast path answers with
        self._flows = False  # the fast path holds the clock
        self._sequence = FrameSequence()
        self._full: Answered | None = None  # what the full path answered last
        self._before: FrameSequence | None = None  # what a RESET ended; it comes back when its sender goes on

    def answer(self, data: bytes, arrival_ns: int, active: Active | None, overloaded: bool = False) -> bytes | None:
        """Bytes to publish for a frame that arrived at ``arrival_ns`` (monotonic clock), or None without a header."""
        if self._flows:
            if active is self._active:
                answer = self._fast.answer(data, arrival_ns)
                if answer is not None:
                    return answer
            self._fast.give(self._sequence.clock)
        answer = self._full_path(data, arrival_ns, active, overloaded)
        certain = self._before is None and self._sequence.track is not None
        self._flows = certain and self._fast.adopt_clock(self._sequence.clock)
        return answer

    @property
    def good(self) -> int:
        """How many setpoints were corrected."""
        return self.counters.good

    @property
    def last_answer(self) -> Answered | None:
        """What was corrected last, for another thread."""
        found = [answered for answered in (self._fast.last_answer(), self._full) if answered is not None]
        return max(found, default=None)

    @property
    def seen_ns(self) -> int:
        """When the last frame in order arrived; 0 before the first."""
        return self._fast.seen_ns if self._flows else self._sequence.clock.seen_ns

    def _full_path(self, data: bytes, arrival_ns: int, active: Active | None, overloaded: bool) -> bytes | None:
        try:
            request = wire.decode_setpoints(data)
        except wire.FrameError as error:
            return self._answer_refusal(error.header, Status.BAD_FRAME, active, 0, arrival_ns)
        status = self._admit(request, arrival_ns, active, overloaded)
        if status != Status.OK or active is None:
            return self._answer_refusal(request.header, status, active, 0, arrival_ns)
        return self._correct(request, arrival_ns, active)

    def _admit(self, request: Setpoints, arrival_ns: int, active: Active | None, overloaded: bool) -> Status:
        """Everything that can be said before the numbers are looked at."""
        header = request.header
        if header.flags & Flag.RESET:
            self._start_sequence(bool(header.flags & Flag.SETTLED))
        elif self._before is not None:
            self._choose(self._before, header.seq, arrival_ns)
        clock = self._sequence.clock
        if not clock.follows(header.seq):
            return clock.refuse(header.seq, arrival_ns, header.t_send_ns, overloaded, self.rules)
        if not clock.advance_to_frame(header.seq, arrival_ns, header.t_send_ns, self.rules):
            return Status.STALE
        if active is None:
            return Status.NO_VERSION
        if header.joints != active.program.n_joints or request.version not in (None, active.number):
            return Status.VERSION_MISMATCH
        return Status.OK

    def _start_sequence(self, settled: bool) -> None:
        """Start a sequence. The one before is kept until a second frame confirms the new one: anybody can send a RESET."""
        if self._before is None and self._sequence.clock.seq >= 0:
            self._before = self._sequence
        self._sequence = FrameSequence(settled=settled)

    def _choose(self, before: FrameSequence, seq: int, arrival_ns: int) -> None:
        """Keep the sequence that this frame goes on with, the new one or the one before."""
        confirms = self._sequence.clock.seq >= 0 and self._sequence.clock.follows(seq)
        returns = before.clock.follows(seq)
        if confirms and returns:
            # The RESET had the number of the frame before it: it is an intruder's while that one is recent.
            confirms = arrival_ns - before.clock.seen_ns > self.rules.recent_ns
        if confirms:
            self._before = None
        elif returns:
            self._sequence, self._before = before, None
            if before.track is not None and before.active is not None:
                self._use(before.track, before.active)

    def _use(self, track: Track, active: Active) -> None:
        self._active = self._sequence.active = active
        self._fast.follow(track, active)

    def _follow_version(self, active: Active) -> Track:
        """The track for this version: the old one goes on, its difference ramped, unless the joints changed."""
        sequence = self._sequence
        if sequence.track is None or sequence.track.program.n_joints != active.program.n_joints:
            sequence.track = Track(active.program, settled=sequence.settled)
            sequence.settled = False
        elif active is not sequence.active:
            sequence.track.change(active.program)
        else:
            return sequence.track
        self._use(sequence.track, active)
        return sequence.track

    def _correct(self, request: Setpoints, arrival_ns: int, active: Active) -> bytes | None:
        track = self._follow_version(active)
        header = request.header
        width = wire.width(header.flags)
        at = header.t_apply_ns or header.t_send_ns
        clock = self._sequence.clock
        dt = clock.elapsed_s(at, arrival_ns, self.rules.time_slack_s)
        if header.kind == Kind.POINT:
            status = track.step(request.values[0], width, dt)
            flags, mask, numbers, info = int(track.info[0]), int(track.info[1]), track.out, track.info
            left_nm = wire.nanometres(info[LEFT]) if status == Status.OK else 0
        else:
            steps = np.full(len(request.values), request.step_ns * 1e-9)
            steps[0] = dt
            walked = walk_whole(track, request.values, width, steps)
            refused, flags, numbers, info = walked.refusal, walked.all_flags, walked.q, walked.info[-1]
            status, mask = (refused.status, refused.limit_mask) if refused else (0, 0)
            left_nm = 0 if refused else wire.nanometres(walked.remaining_error_m)
        if status != Status.OK:
            return self._answer_refusal(header, Status(status), active, mask, arrival_ns)
        points = len(request.values)
        clock.applied_ns = at + (points - 1) * request.step_ns
        clock.answered_ns = arrival_ns
        self.counters.count_made(flags, left_nm, arrival_ns)
        corrected, n = numbers.tobytes(), header.joints
        self._full = Answered(
            arrival_ns, flags, request.values[-1, :n].tobytes(), corrected[-8 * n :], info[TOOL].tobytes(), left_nm
        )
        return wire.encode_answer(
            header,
            corrected,
            version=active.number,
            epoch=active.epoch,
            flags=flags,
            processing_ns=self.counters.count(Status.OK, arrival_ns),
            left_nm=left_nm,
            points=points,
            step_ns=request.step_ns,
        )

    def _answer_refusal(
        self, header: wire.Header | None, status: Status, active: Active | None, mask: int, arrival_ns: int
    ) -> bytes | None:
        """Count a refusal and answer with it, if there is a header to answer to."""
        spent = self.counters.count(status, arrival_ns)
        if header is None:
            return None
        return wire.encode_refusal(
            header,
            status,
            version=active.number if active else 0,
            epoch=active.epoch if active else 0,
            limit_mask=mask,
            processing_ns=spent,
        )
