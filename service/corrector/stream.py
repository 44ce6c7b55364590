"""One stream: bytes in, bytes out, and the memory between. No zenoh in here, so every rule can be tested alone."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.correction import Track
from service.corrector import frames
from service.corrector.active import Active
from service.corrector.frames import Flag, Floats, Kind, Setpoints, Status
from service.corrector.specs import Rules

NOT_DONE = -1
LIMITED, DAMPED, OK = int(Flag.LIMITED), int(Flag.DAMPED), int(Status.OK)
WIDTHS = {0: 1, int(Flag.QD): 2, Flag.QD | Flag.QDD: 3}
MOST_NS = 0xFFFFFFFF  # of the time that fits into an answer


@dataclass
class Counters:
    """What a stream has done, for its status document."""

    by_status: list[int] = field(default_factory=lambda: [0] * len(Status))
    limited: int = 0
    damped: int = 0
    processing_ns: int = 0
    processing_max_ns: int = 0
    last: int = NOT_DONE

    def document(self) -> dict[str, Any]:
        """Counts by name; times are those inside the corrector."""
        answered = sum(self.by_status)
        return {
            "received": answered,
            "counters": {status.name: self.by_status[status] for status in Status},
            "rate_limited": self.limited,
            "damped": self.damped,
            "last_status": Status(self.last).name if self.last >= 0 else None,
            "processing_us": {
                "mean": round(self.processing_ns / answered / 1000.0, 2) if answered else None,
                "max": round(self.processing_max_ns / 1000.0, 2),
            },
        }


class Stream:
    """Answers the setpoints of one controller in order."""

    def __init__(self, rules: Rules | None = None) -> None:
        self.rules = rules or Rules()
        self.counters = Counters()
        self._active: Active | None = None
        self._track: Track | None = None
        self._settled = False
        self._shapes: dict[int, tuple[int, int, Floats, memoryview]] = {}
        self._begin()

    def _begin(self) -> None:
        """Forget sequence and clocks; the next frame is the first."""
        self._flows = False
        self._seq = -1
        self._way_ns: int | None = None
        self._seen_ns = 0
        self._applied_ns = 0
        self._answered_ns = 0

    def answer(self, data: bytes, arrival_ns: int, active: Active | None, overloaded: bool = False) -> bytes | None:
        """Bytes to publish for a frame that arrived at ``arrival_ns`` (monotonic clock), or None without a header."""
        if self._flows and active is self._active:
            answer = self._next_point(data, arrival_ns)
            if answer is not None:
                return answer
        try:
            request = frames.decode_setpoints(data)
        except frames.FrameError as error:
            self._count(Status.BAD_FRAME, arrival_ns)
            return (
                None if error.header is None else self._refusal(error.header, Status.BAD_FRAME, active, 0, arrival_ns)
            )
        status = self._admit(request, arrival_ns, active, overloaded)
        if status != Status.OK or active is None:
            self._count(status, arrival_ns)
            return self._refusal(request.header, status, active, 0, arrival_ns)
        return self._correct(request, arrival_ns, active)

    def _admit(self, request: Setpoints, arrival_ns: int, active: Active | None, overloaded: bool) -> Status:
        """Everything that can be said before the numbers are looked at."""
        header = request.header
        if header.flags & Flag.RESET:
            self._begin()
            self._settled = bool(header.flags & Flag.SETTLED)
            self._track = None
        if header.seq <= self._seq:
            return Status.SEQ_BACK
        gap = self._seq >= 0 and header.seq != self._seq + 1
        self._seq = header.seq
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
        way = arrival_ns - sent_ns
        if self._way_ns is None:
            self._way_ns = way
        else:
            grown = self._way_ns + int((arrival_ns - self._seen_ns) * self.rules.clock_drift)
            self._way_ns = min(grown, way)
        self._seen_ns = arrival_ns
        return way - self._way_ns > self.rules.max_age_ns

    def _follow_version(self, active: Active) -> Track:
        """The track for this version: the old one goes on, its difference ramped, unless the joints changed."""
        if self._track is None or self._track.program.n_joints != active.program.n_joints:
            self._track = Track(active.program, settled=self._settled)
            self._settled = False
            self._shapes = _shapes(active.program.n_joints)
        elif active is not self._active:
            self._track.change(active.program)
        self._active = active
        return self._track

    def _elapsed(self, at_ns: int, arrival_ns: int) -> float:
        """Time since the last answered setpoint on the controller's clock, bounded by the time that really passed."""
        passed = (arrival_ns - self._answered_ns) * 1e-9 + self.rules.time_slack_s
        return min(max((at_ns - self._applied_ns) * 1e-9, 0.0), passed)

    def _next_point(self, data: bytes, arrival_ns: int) -> bytes | None:
        """Answer to a plain setpoint that is the next in order and good; None for any other, which nothing has touched.

        Nearly all frames of a stream are that. What :meth:`_admit` and :meth:`_correct` do is done here without their
        objects: cold, as between two setpoints, every line of Python counts (62 µs became 33 on a busy machine).
        """
        if len(data) <= frames.HEADER.size:
            return None
        magic, kind, joints, flags, seq, sent_ns, apply_ns = frames.HEADER.unpack_from(data)
        shape = self._shapes.get(flags)
        track, active = self._track, self._active
        if shape is None or kind or seq != self._seq + 1 or magic != frames.MAGIC or track is None or active is None:
            return None
        size, width, values, raw = shape
        if len(data) != size or joints != track.program.n_joints or self._way_ns is None:
            return None
        way = arrival_ns - sent_ns
        least = min(way, self._way_ns + int((arrival_ns - self._seen_ns) * self.rules.clock_drift))
        if way - least > self.rules.max_age_ns:
            return None
        raw[:] = data[frames.HEADER.size :]
        at = apply_ns or sent_ns
        if track.step(values, width, self._elapsed(at, arrival_ns)) != OK:
            return None  # a refused setpoint leaves no trace in the track: it is refused once more, and told so
        self._seq, self._way_ns, self._seen_ns = seq, least, arrival_ns
        self._applied_ns, self._answered_ns = at, arrival_ns
        made = int(track.info.item(0))
        counters = self.counters
        if made & LIMITED:
            counters.limited += 1
        if made & DAMPED:
            counters.damped += 1
        spent = self._count(OK, arrival_ns)
        head = frames.POINT_ANSWER.pack(
            magic, kind, joints, made, seq, sent_ns, apply_ns, active.number, active.epoch, OK, 0, spent, 0
        )
        return head + track.out.tobytes()

    def _correct(self, request: Setpoints, arrival_ns: int, active: Active) -> bytes:
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
            self._count(Status(status), arrival_ns)
            return self._refusal(header, Status(status), active, int(info[1]), arrival_ns)
        points = len(request.values)
        self._applied_ns = at + (points - 1) * request.step_ns
        self._answered_ns = arrival_ns
        self._flows = True
        flags = int(info[0])
        self.counters.limited += bool(flags & Flag.LIMITED)
        self.counters.damped += bool(flags & Flag.DAMPED)
        return frames.encode_answer(
            header,
            numbers.tobytes(),
            version=active.number,
            epoch=active.epoch,
            flags=flags,
            processing_ns=self._count(Status.OK, arrival_ns),
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

    def _refusal(
        self, header: frames.Header, status: Status, active: Active | None, mask: int, arrival_ns: int
    ) -> bytes:
        return frames.encode_refusal(
            header,
            status,
            version=active.number if active else 0,
            epoch=active.epoch if active else 0,
            limit_mask=mask,
            processing_ns=max(0, min(time.monotonic_ns() - arrival_ns, MOST_NS)),
        )

    def _count(self, status: int, arrival_ns: int) -> int:
        """Count an answer; returns the time spent on it, ns, as it fits into the frame."""
        spent = max(0, min(time.monotonic_ns() - arrival_ns, MOST_NS))
        counters = self.counters
        counters.by_status[status] += 1
        counters.processing_ns += spent
        if spent > counters.processing_max_ns:
            counters.processing_max_ns = spent
        counters.last = status
        return spent


def _shapes(joints: int) -> dict[int, tuple[int, int, Floats, memoryview]]:
    """By the flags of a plain setpoint: its size, vectors per point, room for its numbers, and that room as bytes."""
    made = {}
    for flags, width in WIDTHS.items():
        values = np.zeros(width * joints)
        made[flags] = (frames.HEADER.size + values.nbytes, width, values, values.data.cast("B"))
    return made
