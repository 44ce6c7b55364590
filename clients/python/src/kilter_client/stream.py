"""Corrected setpoints for a controller written in Python: one call per cycle, with a deadline.

    from kilter_client.stream import corrected

    for q in corrected(setpoints, robot="katana450", period_s=0.004):
        send_to_arm(q)

Joints are radians (metres for a prismatic joint). Every answer says where it comes from: "corrected"; "slowed", when
the correction is followed more slowly than the corrector answers; "held", when the answer was late or refused and the
last correction is used again; or "bypass", when that lasted too long and the correction is being released.
``q.damped``, ``q.saturated`` and ``q.slowed`` say what held a correction back, ``q.left_mm`` what that leaves at the
tool. Nothing here needs numpy; zenoh is loaded when a stream is opened.
"""

from __future__ import annotations

import atexit
import math
import queue
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from kilter_client.signing import Session
from kilter_client.streaming.accepted_versions import Acceptance, InUse
from kilter_client.streaming.certificates import StreamError, find_corrector, why_not
from kilter_client.streaming.frames import QD, QDD, RESET, SETTLED, Answer, Setpoint, Statistics
from kilter_client.streaming.held_correction import Carried, farthest
from kilter_client.streaming.link import AGAIN, GONE, Link, Place, Sessions

__all__ = ["CorrectedStream", "Setpoint", "Statistics", "StreamError", "corrected", "find_corrector"]

_SLACK_NS = 100_000_000  # by which setpoints may act further apart than they are sent
_MISSES = 3  # answers missed in a row, after which the corrector is asked for its nonce
_LOST_ITS_PLACE = ("STALE", "SEQ_BACK", "RATE_LIMIT")  # the corrector's past refuses, so it starts anew
_LOST_FRAMES = ("SEQ_GAP", "OVERLOAD")  # so it does when these come twice in a row


class CorrectedStream(Link):
    """A stream to the corrector of one robot; use it in a ``with`` block.

    Args:
        robot: name of the robot on the server.
        endpoints: zenoh endpoints of the corrector; default is what the corrector file of this machine says.
        site: site name in the keys; default as endpoints.
        stream: name of this stream; two controllers must not share one.
        deadline_s: how long a cycle may wait for its answer; less than its period.
        hold_cycles: for how many cycles the last correction is used again before the stream reports bypass.
        release_s: in bypass the last correction fades out over this time, and fades in again afterwards.
        settled: the arm rests at the first setpoint, so give it the whole correction at once; else it ramps in.
        version: number of the version to insist on (``active["version"]``, hexadecimal); others are refused.
        largest_deg: no correction of a joint beyond this is taken, whatever the version allows.
        largest_mm: the same for prismatic joints.
        quickest_s: the time in which the correction may change from nothing to ``largest_deg`` (or ``largest_mm``) while the
            arm rests, and no faster than the version states. For a version that states no rate (of a corrector of an
            earlier release) it may change by a tenth of the motion besides.
        connect_timeout_s: how long to wait for the corrector and its version when the stream is opened.
        data: data folder of the server, to find the corrector file.
        session: keys of a session (``kilter_client.signing.from_document`` of an answer of the API); default is a new one.
        signed: False for unsigned setpoints, which a corrector may take on its own machine; default is signed wherever a
            session can be had.
        take_over: end the session of somebody else who holds the stream; else that is a StreamError, which says who.
        zenoh_config: zenoh configuration with the certificates of this controller, as `kilterd zenoh-config` writes it.

    """

    def __init__(
        self,
        robot: str,
        *,
        endpoints: Sequence[str] | None = None,
        site: str | None = None,
        stream: str = "main",
        deadline_s: float = 0.004,
        hold_cycles: int = 5,
        release_s: float = 0.5,
        settled: bool = False,
        version: int | None = None,
        largest_deg: float = 5.0,
        largest_mm: float = 10.0,
        quickest_s: float = 0.2,
        connect_timeout_s: float = 5.0,
        data: Path | None = None,
        session: Session | None = None,
        signed: bool | None = None,
        take_over: bool = False,
        zenoh_config: Path | None = None,
        statistics: Statistics | None = None,
    ) -> None:
        found: dict[str, Any] = {}
        by_file = False
        if endpoints is None or site is None:
            found = find_corrector(data)
            by_file = endpoints is None
            endpoints = endpoints or list(found["endpoints"].values())
            site = site or str(found["site"])
        self.statistics = statistics or Statistics()
        in_use = InUse(math.radians(largest_deg), largest_mm / 1000.0, quickest_s)
        place = Place(site, robot, stream, tuple(endpoints))
        sessions = Sessions(site, robot, stream, endpoints, found, signed, take_over)
        super().__init__(
            place,
            self.statistics,
            in_use,
            sessions,
            sessions.initial_session(session),
            zenoh_config,
            partial(_current_place, place, data) if by_file else lambda: None,
        )
        self.robot = robot
        self.deadline_s = deadline_s
        self.connect_timeout_s = connect_timeout_s
        self._acceptance = Acceptance(self.statistics, in_use, version, self._ask_again.set, self._signer)
        self._carried = Carried(in_use, self.statistics, settled, hold_cycles, release_s)
        self._settled = settled
        self._flags = RESET | (SETTLED if settled else 0)
        self._wanted: tuple[float, ...] = ()  # the last setpoint, and when it was sent
        self._sent_ns = self._applied_ns = 0  # the latter as the caller said, 0 when not
        self._lost = False  # the last answer said that frames are missing
        self._misses = 0  # in a row

    def __enter__(self) -> CorrectedStream:
        """Open the stream.

        Raises:
            StreamError: no zenoh, no corrector, or no active version within the connect timeout.

        """
        try:
            import zenoh
        except ImportError as error:
            raise StreamError("Streams need zenoh: pip install eclipse-zenoh.") from error
        try:
            self._session = self._open(zenoh, self._place.endpoints)
        except zenoh.ZError as error:
            why = why_not(zenoh, self._place.endpoints, self._zenoh_config) or self._silent
            raise StreamError(why) from error
        atexit.register(self.close)
        try:
            self._declare(zenoh)
            self._wait_for_version(zenoh, self.connect_timeout_s, self._zenoh_config)
            self._follower = threading.Thread(target=self._follow, name="versions", daemon=True)
            self._follower.start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Close the stream."""
        self.close()

    def correct(
        self,
        q: Sequence[float],
        qd: Sequence[float] | None = None,
        qdd: Sequence[float] | None = None,
        *,
        t_apply_ns: int = 0,
    ) -> Setpoint:
        """Correct one setpoint, within the deadline whatever happens.

        Args:
            q: wanted joints, rad or m.
            qd: their speeds; with ``qdd`` the load includes motion.
            qdd: their accelerations.
            t_apply_ns: when the setpoint is to act, on any clock that counts nanoseconds; default is now.

        """
        wanted = self._validate_setpoint(q)
        values: Sequence[float] = wanted
        flags = self._flags
        if qd is not None and qdd is not None:
            values = [*wanted, *qd, *qdd]
            self._validate_setpoint(values, 3)
            flags |= QD | QDD
        before, last_ns = self._wanted or wanted, self._sent_ns
        answer, trip = self._ask(values, wanted, flags, t_apply_ns)
        self._wanted = wanted
        pause_s, moved = self._pause_s(last_ns, t_apply_ns), farthest(wanted, before)
        if answer is None or answer.status != "OK":
            self._react_to_refusal(answer)
            return self._carried.hold(wanted, answer)
        self._lost = False
        return self._carried.follow(wanted, answer, trip, pause_s, moved)

    def _validate_setpoint(self, q: Sequence[float], width: int = 1) -> tuple[float, ...]:
        """A setpoint as numbers, as many as the robot has joints."""
        if len(q) != width * self.joints:
            raise StreamError(
                f"Robot {self.robot!r} has {self.joints} joints, and this setpoint has {len(q)} numbers: "
                f"give {'q, qd and qdd of ' if width > 1 else ''}every joint."
            )
        return tuple(map(float, q))

    def correct_chunk(self, points: Sequence[Sequence[float]], step_s: float, *, t_apply_ns: int = 0) -> Answer | None:
        """Correct several setpoints ``step_s`` apart in one frame; None when no answer came within the deadline.

        Raises:
            StreamError: a point has another number of joints than the robot, or there is none.

        """
        rows = [self._validate_setpoint(point) for point in points]
        if not rows:
            raise StreamError("A chunk has no points: give at least one.")
        values = [x for row in rows for x in row]
        last_ns, step_ns = self._sent_ns, round(step_s * 1e9)
        answer, _ = self._ask(values, values, self._flags, t_apply_ns, points=len(rows), step_ns=step_ns)
        pause_s = self._pause_s(last_ns, t_apply_ns, (len(rows) - 1) * step_ns)
        if answer is None or answer.status != "OK":
            self._react_to_refusal(answer)
            self._wanted = rows[-1]
            return answer
        self._lost = False
        steps = [pause_s] + [step_s] * (len(rows) - 1)
        q, lag = self._carried.follow_chunk([self._wanted or rows[0], *rows], answer.q, steps)
        self._wanted = rows[-1]
        self.statistics.note(answer.flags, answer.left_nm)
        return answer._replace(q=q, lag=lag)

    def _pause_s(self, last_ns: int, t_apply_ns: int, ahead_ns: int = 0) -> float:
        """Time since the setpoint before it, sent at ``last_ns``, as the corrector takes it: by when they act, if that is said.

        A cycle that begins late does not act late. ``ahead_ns``: how long after the first point of a chunk its last one acts.
        """
        passed, step = self._sent_ns - last_ns, t_apply_ns - self._applied_ns
        stated = t_apply_ns and self._applied_ns and step > 0
        self._applied_ns = t_apply_ns and t_apply_ns + ahead_ns
        return (min(step, passed + _SLACK_NS) if stated else passed) * 1e-9

    def _ask(
        self, values: Sequence[float], wanted: Sequence[float], flags: int, t_apply_ns: int, **chunk: int
    ) -> tuple[Answer | None, float]:
        """Send a frame and wait for its answer until the deadline; nothing of both while no corrector is there."""
        self.statistics.sent += 1
        if not self._alive:  # a controller keeps its pace
            self.statistics.missed += 1
            self._sent_ns = time.monotonic_ns()
            return None, math.nan
        data, sent = self._acceptance.frame(values, wanted, self.joints, flags, t_apply_ns, **chunk)
        self._sent_ns = sent
        self._publisher.put(data)
        end_ns = sent + int(self.deadline_s * 1e9)
        answer = self._wait(end_ns)
        if answer == AGAIN:  # once: with the corrector's nonce it fits
            self._publisher.put(self._acceptance.frame(values, wanted, self.joints, flags, t_apply_ns, **chunk)[0])
            answer = self._wait(end_ns)
        if not isinstance(answer, Answer):
            self._miss()
            return None, math.nan
        self._misses = 0
        trip = (time.monotonic_ns() - sent) * 1e-9
        self.statistics.round_trips_s.append(trip)
        return answer, trip

    def _miss(self) -> None:
        self.statistics.missed += 1
        self._misses += 1
        if self._signer is not None and self._misses % _MISSES == 0:
            self._publisher.put(self._signer.greeting())  # the corrector may have been restarted
            if self._sessions.mark_unanswered():
                self._ask_again.set()

    def _wait(self, end_ns: int) -> Answer | bytes | None:
        """The answer to the setpoint just sent; None when it does not come in time, or the corrector is gone."""
        while True:
            left = (end_ns - time.monotonic_ns()) * 1e-9
            try:
                data = self._answers.get(timeout=left) if left > 0 else self._answers.get_nowait()
            except queue.Empty:
                return None
            if data is GONE:
                if self._alive:
                    continue
                return None
            if data is AGAIN:
                return data
            answer = self._accept(data)
            if answer is not None:
                return answer

    def _accept(self, data: bytes) -> Answer | None:
        """The answer to the setpoint just sent, if it is accepted; others are dropped."""
        answer = self._acceptance.judge(data)
        if answer is not None:
            self._flags &= ~(RESET | SETTLED)  # the corrector has heard of the new sequence
        return answer

    def _react_to_refusal(self, answer: Answer | None) -> None:
        """Count a refusal, and start the corrector anew after one that its past is the reason of."""
        if answer is None:
            return
        self.statistics.refused[answer.status] += 1
        if answer.status == "SESSION_EXPIRED":
            self._sessions.mark_expired()
            self._ask_again.set()
        again = self._lost and answer.status in _LOST_FRAMES
        self._lost = answer.status in _LOST_FRAMES
        if again or answer.status in _LOST_ITS_PLACE:
            # At once, not ramped: the correction goes on where it is, and changes no faster than it may.
            self._flags |= RESET | (SETTLED if self._carried.delta or self._settled else 0)


def _current_place(place: Place, data: Path | None) -> Place | None:
    """Where the corrector file says that a stream is now; None while there is none, or it is of another site."""
    try:
        found = find_corrector(data)
        endpoints = tuple(found["endpoints"].values())
    except (StreamError, KeyError, AttributeError):
        return None
    return replace(place, endpoints=endpoints) if found.get("site") == place.site else None


def corrected(
    setpoints: Iterable[Sequence[float]], robot: str, *, period_s: float | None = None, **options: Any
) -> Iterator[Setpoint]:
    """Yield the corrected setpoint of every one in ``setpoints``, one each ``period_s``; without it as they come.

    Further options are those of :class:`CorrectedStream`; pass ``statistics=Statistics()`` to look at it afterwards. The
    deadline is four fifths of the period unless it is given.
    """
    if period_s is not None:
        options.setdefault("deadline_s", 0.8 * period_s)
    with CorrectedStream(robot, **options) as stream:
        start = time.monotonic_ns()
        for k, q in enumerate(setpoints):
            apply_ns = 0
            if period_s is not None:
                apply_ns = start + round(k * period_s * 1e9)
                left = (apply_ns - time.monotonic_ns()) * 1e-9
                stream.statistics.overruns += left < -period_s
                time.sleep(max(0.0, left))
            yield stream.correct(q, t_apply_ns=apply_ns)
