"""One stream: bytes in, bytes out, and the memory between. No zenoh in here, so every rule can be tested alone."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from kilter_core.correct.program import Track
from kilter_service.corrector import frames
from kilter_service.corrector.active import Active
from kilter_service.corrector.admission import Clock
from kilter_service.corrector.frames import Flag, Kind, Setpoints, Status
from kilter_service.corrector.short_way import ShortWay
from kilter_service.corrector.specs import Rules


@dataclass
class Course:
    """One sequence of frames, from its start: where it stands, and the memory of its correction."""

    clock: Clock = field(default_factory=Clock)
    settled: bool = False
    track: Track | None = None
    active: Active | None = None


class Stream:
    """Answers the setpoints of one controller in order."""

    def __init__(self, rules: Rules | None = None) -> None:
        self.rules = rules or Rules()
        self._short = ShortWay(self.rules)
        self.counters = self._short.counters
        self._active: Active | None = None  # what the short way answers with
        self._flows = False  # the short way holds the clock
        self._course = Course()
        self._before: Course | None = None  # what a RESET ended; it comes back when its sender goes on

    def answer(self, data: bytes, arrival_ns: int, active: Active | None, overloaded: bool = False) -> bytes | None:
        """Bytes to publish for a frame that arrived at ``arrival_ns`` (monotonic clock), or None without a header."""
        if self._flows:
            if active is self._active:
                answer = self._short.answer(data, arrival_ns)
                if answer is not None:
                    return answer
            self._short.give(self._course.clock)
        answer = self._long_way(data, arrival_ns, active, overloaded)
        certain = self._before is None and self._course.track is not None
        self._flows = certain and self._short.take(self._course.clock)
        return answer

    @property
    def good(self) -> int:
        """How many setpoints were corrected."""
        return self.counters.good

    @property
    def seen_ns(self) -> int:
        """When the last frame in order arrived; 0 before the first."""
        return self._short.seen_ns if self._flows else self._course.clock.seen_ns

    def _long_way(self, data: bytes, arrival_ns: int, active: Active | None, overloaded: bool) -> bytes | None:
        try:
            request = frames.decode_setpoints(data)
        except frames.FrameError as error:
            return self._refused(error.header, Status.BAD_FRAME, active, 0, arrival_ns)
        status = self._admit(request, arrival_ns, active, overloaded)
        if status != Status.OK or active is None:
            return self._refused(request.header, status, active, 0, arrival_ns)
        return self._correct(request, arrival_ns, active)

    def _admit(self, request: Setpoints, arrival_ns: int, active: Active | None, overloaded: bool) -> Status:
        """Everything that can be said before the numbers are looked at."""
        header = request.header
        if header.flags & Flag.RESET:
            self._begin(bool(header.flags & Flag.SETTLED))
        elif self._before is not None:
            self._choose(self._before, header.seq, arrival_ns)
        clock = self._course.clock
        if not clock.follows(header.seq):
            return clock.refuse(header.seq, arrival_ns, header.t_send_ns, overloaded, self.rules)
        if not clock.take(header.seq, arrival_ns, header.t_send_ns, self.rules):
            return Status.STALE
        if active is None:
            return Status.NO_VERSION
        if header.joints != active.program.n_joints or request.version not in (None, active.number):
            return Status.VERSION_MISMATCH
        return Status.OK

    def _begin(self, settled: bool) -> None:
        """Start a course. The one before is kept until a second frame confirms the new one: anybody can send a RESET."""
        if self._before is None and self._course.clock.seq >= 0:
            self._before = self._course
        self._course = Course(settled=settled)

    def _choose(self, before: Course, seq: int, arrival_ns: int) -> None:
        """Keep the course that this frame goes on with, the new one or the one before."""
        confirms = self._course.clock.seq >= 0 and self._course.clock.follows(seq)
        returns = before.clock.follows(seq)
        if confirms and returns:
            # The RESET had the number of the frame before it: it is an intruder's while that one is recent.
            confirms = arrival_ns - before.clock.seen_ns > self.rules.recent_ns
        if confirms:
            self._before = None
        elif returns:
            self._course, self._before = before, None
            if before.track is not None and before.active is not None:
                self._use(before.track, before.active)

    def _use(self, track: Track, active: Active) -> None:
        self._active = self._course.active = active
        self._short.follow(track, active)

    def _follow_version(self, active: Active) -> Track:
        """The track for this version: the old one goes on, its difference ramped, unless the joints changed."""
        course = self._course
        if course.track is None or course.track.program.n_joints != active.program.n_joints:
            course.track = Track(active.program, settled=course.settled)
            course.settled = False
        elif active is not course.active:
            course.track.change(active.program)
        else:
            return course.track
        self._use(course.track, active)
        return course.track

    def _correct(self, request: Setpoints, arrival_ns: int, active: Active) -> bytes | None:
        track = self._follow_version(active)
        header = request.header
        width = frames.width(header.flags)
        at = header.t_apply_ns or header.t_send_ns
        clock = self._course.clock
        dt = clock.elapsed_s(at, arrival_ns, self.rules.time_slack_s)
        if header.kind == Kind.POINT:
            status = track.step(request.values[0], width, dt)
            info, numbers = track.info, track.out
        else:
            status, info, numbers = self._chunk(track, request, width, dt)
        if status != Status.OK:
            return self._refused(header, Status(status), active, int(info[1]), arrival_ns)
        points = len(request.values)
        clock.applied_ns = at + (points - 1) * request.step_ns
        clock.answered_ns = arrival_ns
        flags = int(info[0])
        self.counters.count_flags(flags)
        return frames.encode_answer(
            header,
            numbers.tobytes(),
            version=active.number,
            epoch=active.epoch,
            flags=flags,
            processing_ns=self.counters.count(Status.OK, arrival_ns),
            points=points,
            step_ns=request.step_ns,
        )

    @staticmethod
    def _chunk(
        track: Track, request: Setpoints, width: int, dt: float
    ) -> tuple[int, NDArray[np.float64], NDArray[np.float64]]:
        """All points or none: a refused point refuses the chunk and leaves the memory as it was."""
        steps = np.full(len(request.values), request.step_ns * 1e-9)
        steps[0] = dt
        done, out, info, status = track.follow(request.values, width, steps, atomic=True)
        if done < len(out):
            return int(status[done]), info[done], out
        whole = info[-1].copy()
        whole[0] = np.bitwise_or.reduce(info[:, 0].astype(np.int64))
        return 0, whole, out

    def _refused(
        self, header: frames.Header | None, status: Status, active: Active | None, mask: int, arrival_ns: int
    ) -> bytes | None:
        """Count a refusal and answer with it, if there is a header to answer to."""
        spent = self.counters.count(status, arrival_ns)
        if header is None:
            return None
        return frames.encode_refusal(
            header,
            status,
            version=active.number if active else 0,
            epoch=active.epoch if active else 0,
            limit_mask=mask,
            processing_ns=spent,
        )
