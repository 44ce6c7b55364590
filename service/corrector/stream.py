"""One stream: bytes in, bytes out, and the memory between. No zenoh in here, so every rule can be tested alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from core.correction import Track
from service.corrector import frames
from service.corrector.active import Active
from service.corrector.frames import Flag, Kind, Setpoints, Status
from service.corrector.short_way import Clock, ShortWay
from service.corrector.specs import Rules


class Stream:
    """Answers the setpoints of one controller in order."""

    def __init__(self, rules: Rules | None = None) -> None:
        self.rules = rules or Rules()
        self._short = ShortWay(self.rules)
        self.counters = self._short.counters
        self._active: Active | None = None
        self._track: Track | None = None
        self._settled = False
        self._flows = False  # the short way holds the clock
        self._clock = Clock()

    def answer(self, data: bytes, arrival_ns: int, active: Active | None, overloaded: bool = False) -> bytes | None:
        """Bytes to publish for a frame that arrived at ``arrival_ns`` (monotonic clock), or None without a header."""
        if self._flows:
            if active is self._active:
                answer = self._short.answer(data, arrival_ns)
                if answer is not None:
                    return answer
            self._clock = self._short.give()
        answer = self._long_way(data, arrival_ns, active, overloaded)
        self._flows = self._track is not None and self._short.take(self._clock)
        return answer

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
            self._clock = Clock()
            self._settled = bool(header.flags & Flag.SETTLED)
            self._track = None
        clock = self._clock
        if header.seq <= clock.seq:
            return Status.SEQ_BACK
        gap = clock.seq >= 0 and header.seq != clock.seq + 1
        clock.seq = header.seq
        if self._is_stale(arrival_ns, header.t_send_ns):
            return Status.STALE
        if gap:
            return Status.OVERLOAD if overloaded else Status.SEQ_GAP
        if active is None:
            return Status.NO_VERSION
        if header.joints != active.program.n_joints or request.version not in (None, active.number):
            return Status.VERSION_MISMATCH
        return Status.OK

    def _is_stale(self, arrival_ns: int, sent_ns: int) -> bool:
        way, clock = arrival_ns - sent_ns, self._clock
        if clock.way_ns is None:
            clock.way_ns = way
        else:
            grown = clock.way_ns + int((arrival_ns - clock.seen_ns) * self.rules.clock_drift)
            clock.way_ns = min(grown, way)
        clock.seen_ns = arrival_ns
        return way - clock.way_ns > self.rules.max_age_ns

    def _follow_version(self, active: Active) -> Track:
        """The track for this version: the old one goes on, its difference ramped, unless the joints changed."""
        if self._track is None or self._track.program.n_joints != active.program.n_joints:
            self._track = Track(active.program, settled=self._settled)
            self._settled = False
        elif active is not self._active:
            self._track.change(active.program)
        else:
            return self._track
        self._active = active
        self._short.follow(self._track, active)
        return self._track

    def _elapsed(self, at_ns: int, arrival_ns: int) -> float:
        """Time since the last answered setpoint on the controller's clock, bounded by the time that really passed."""
        passed = (arrival_ns - self._clock.answered_ns) * 1e-9 + self.rules.time_slack_s
        return min(max((at_ns - self._clock.applied_ns) * 1e-9, 0.0), passed)

    def _correct(self, request: Setpoints, arrival_ns: int, active: Active) -> bytes | None:
        track = self._follow_version(active)
        header = request.header
        width = frames.width(header.flags)
        at = header.t_apply_ns or header.t_send_ns
        dt = self._elapsed(at, arrival_ns)
        if header.kind == Kind.POINT:
            status = track.step(request.values[0], width, dt)
            info, numbers = track.info, track.out
        else:
            status, info, numbers = self._chunk(track, request, width, dt)
        if status != Status.OK:
            return self._refused(header, Status(status), active, int(info[1]), arrival_ns)
        points = len(request.values)
        self._clock.applied_ns = at + (points - 1) * request.step_ns
        self._clock.answered_ns = arrival_ns
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
