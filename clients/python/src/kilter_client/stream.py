"""Corrected setpoints for a controller written in Python: one call per cycle, with a deadline.

    from kilter_client.stream import corrected

    for q in corrected(setpoints, robot="katana450", period_s=0.004):
        send_to_arm(q)

Joints are radians (metres for a joint that slides). Every answer says where it comes from: "corrected"; "held", when
the answer was late or refused and the last correction is used again; or "bypass", when that lasted too long and the
correction is being released. Nothing here needs numpy; zenoh is loaded when a stream is opened.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import math
import os
import queue
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from kilter_client.frames import QD, QDD, RESET, SETTLED, Answer, decode, encode
from kilter_client.setpoint import Setpoint, Statistics

__all__ = ["CorrectedStream", "Setpoint", "Statistics", "StreamError", "corrected", "find_corrector"]

_GONE = b""  # put into the queue when the corrector is gone, to end a wait


class StreamError(Exception):
    """The stream cannot be opened; the message says what to do."""


def find_corrector(data: Path | None = None) -> dict[str, Any]:
    """Read the corrector file of this machine: site and endpoints.

    Raises:
        StreamError: there is none.

    """
    folder = data or Path(os.environ.get("KILTER_DATA") or Path.home() / ".kilter")
    try:
        document: dict[str, Any] = json.loads((folder / "corrector.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise StreamError(
            f"No corrector was found through {folder / 'corrector.json'}: start `kilterd serve`, set KILTER_DATA, "
            "or give endpoints."
        ) from error
    return document


def _session_config(zenoh: Any, endpoints: Sequence[str]) -> Any:
    """Peer that connects to the endpoints and to nobody else, and comes back within half a second."""
    config = zenoh.Config()
    settings: dict[str, object] = {
        "mode": "peer",
        "listen/endpoints": [],
        "connect/endpoints": list(endpoints),
        "connect/timeout_ms": 0,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": 1000,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


class CorrectedStream:
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
        connect_timeout_s: how long to wait for the corrector and its version when the stream is opened.
        data: data folder of the server, to find the corrector file.

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
        connect_timeout_s: float = 5.0,
        data: Path | None = None,
        statistics: Statistics | None = None,
    ) -> None:
        if endpoints is None or site is None:
            found = find_corrector(data)
            endpoints = endpoints or list(found["endpoints"].values())
            site = site or str(found["site"])
        self.robot = robot
        self.deadline_s = deadline_s
        self.hold_cycles = hold_cycles
        self.release_s = release_s
        self.connect_timeout_s = connect_timeout_s
        self.statistics = statistics or Statistics()
        self.active: dict[str, Any] | None = None
        self._endpoints = endpoints
        self._site = site
        self._root = f"kilter/@v1/{site}/{robot}"
        self._stream = stream
        self._version = version
        self._flags = RESET | (SETTLED if settled else 0)
        self._seq = 0
        self._epochs: dict[int, str] = {}
        self._known = threading.Event()
        self._alive: set[str] = set()
        self._answers: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._delta: tuple[float, ...] = ()
        self._misses = 0
        self._offset: tuple[float, ...] = ()
        self._fade_ns = 0
        self._session: Any = None

    def __enter__(self) -> CorrectedStream:
        """Open the stream.

        Raises:
            StreamError: no zenoh, no corrector, or no active version within the connect timeout.

        """
        try:
            import zenoh
        except ImportError as error:
            raise StreamError("Streams need zenoh: pip install 'kilter-client[stream]'.") from error
        self._session = zenoh.open(_session_config(zenoh, self._endpoints))
        atexit.register(self.close)
        try:
            self._declare(zenoh)
            self._wait_for_version()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Close the stream."""
        self.close()

    def close(self) -> None:
        """Close the session; safe to call twice."""
        atexit.unregister(self.close)
        if self._session is not None:
            self._session.close()
            self._session = None

    @property
    def alive(self) -> bool:
        """Whether a corrector that serves the robot is known to be there."""
        return bool(self._alive)

    def _declare(self, zenoh: Any) -> None:
        session = self._session
        self._deleted = zenoh.SampleKind.DELETE
        # Direct callbacks only hand bytes over: no zenoh call, no thread of their own that could hang at exit.
        direct = {"indirect": False}
        session.declare_subscriber(
            f"{self._root}/stream/{self._stream}/out",
            zenoh.handlers.Callback(lambda sample: self._answers.put(sample.payload.to_bytes()), **direct),
        )
        session.declare_subscriber(f"{self._root}/active", zenoh.handlers.Callback(self._on_active, **direct))
        session.liveliness().declare_subscriber(
            f"{self._root}/@alive/*", zenoh.handlers.Callback(self._on_liveliness, **direct), history=True
        )
        self._publisher = session.declare_publisher(
            f"{self._root}/stream/{self._stream}/in",
            priority=zenoh.Priority.REAL_TIME,
            congestion_control=zenoh.CongestionControl.DROP,
            express=False,
        )

    def _on_active(self, sample: Any) -> None:
        self._learn(sample.payload.to_bytes())

    def _learn(self, payload: bytes) -> None:
        with contextlib.suppress(ValueError, TypeError):
            document = json.loads(payload)
            if document.get("epoch") is None:
                self.active = None
                self._epochs = {}
                return
            # The one before stays known: its last answers are on their way.
            recent = dict(list(self._epochs.items())[-1:])
            self._epochs = {**recent, int(document["epoch"]): str(document["version_id"])}
            self.active = document
            self._known.set()

    def _on_liveliness(self, sample: Any) -> None:
        if sample.kind == self._deleted:
            self._alive.discard(str(sample.key_expr))
            if not self._alive:
                self._answers.put(_GONE)
        else:
            self._alive.add(str(sample.key_expr))

    def _wait_for_version(self) -> None:
        """Ask for the active version until somebody knows it and the way to the corrector is open."""
        end = time.monotonic() + self.connect_timeout_s
        while True:
            for reply in self._session.get(f"{self._root}/active", timeout=0.5):
                if reply.ok is not None:
                    self._learn(reply.ok.payload.to_bytes())
            if self._known.is_set() and self.alive and self._publisher.matching_status.matching:
                return
            if time.monotonic() > end:
                break
            time.sleep(0.02)
        where = f"The corrector at {', '.join(self._endpoints)}"
        if self._publisher.matching_status.matching:
            raise StreamError(
                f"{where} knows no active version of a robot {self.robot!r}: activate one with `kilter activate`, or mend "
                "the robot's name."
            )
        raise StreamError(f"{where} does not answer: is `kilterd serve` up, and its site {self._site!r}?")

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
        wanted = tuple(float(x) for x in q)
        values = [*wanted]
        flags = self._flags
        if qd is not None and qdd is not None:
            values += [*qd, *qdd]
            flags |= QD | QDD
        answer, trip = self._ask(values, len(wanted), flags, t_apply_ns)
        if answer is None or answer.status != "OK" or len(answer.q) != len(wanted):
            return self._hold(wanted, answer)
        delta = tuple(a - b for a, b in zip(answer.q, wanted, strict=True))
        self.statistics.corrected += 1
        return self._resume(wanted, delta, answer, trip)

    def correct_chunk(self, points: Sequence[Sequence[float]], step_s: float, *, t_apply_ns: int = 0) -> Answer | None:
        """Correct several setpoints ``step_s`` apart in one frame; None when no answer came within the deadline."""
        values = [x for point in points for x in point]
        answer, _ = self._ask(
            values, len(points[0]), self._flags, t_apply_ns, points=len(points), step_ns=round(step_s * 1e9)
        )
        return answer

    def _ask(
        self, values: Sequence[float], joints: int, flags: int, t_apply_ns: int, **chunk: int
    ) -> tuple[Answer | None, float]:
        """Send a frame and wait for its answer until the deadline; nothing of both while no corrector is there."""
        self.statistics.sent += 1
        if not self._alive:  # a controller keeps its pace
            self.statistics.missed += 1
            return None, math.nan
        self._seq += 1
        sent = time.monotonic_ns()
        self._publisher.put(
            encode(
                values, joints=joints, seq=self._seq, t_send_ns=sent, t_apply_ns=t_apply_ns, flags=flags,
                version=self._version, **chunk,
            )
        )  # fmt: skip
        end = sent + int(self.deadline_s * 1e9)
        while True:
            left = (end - time.monotonic_ns()) * 1e-9
            try:
                data = self._answers.get(timeout=left) if left > 0 else self._answers.get_nowait()
            except queue.Empty:
                self.statistics.missed += 1
                return None, math.nan
            if data is _GONE:
                if self._alive:
                    continue
                self.statistics.missed += 1
                return None, math.nan
            answer = self._accept(data)
            if answer is not None:
                trip = (time.monotonic_ns() - sent) * 1e-9
                self.statistics.round_trips_s.append(trip)
                return answer, trip

    def _accept(self, data: bytes) -> Answer | None:
        """The answer to the setpoint just sent, of an announced epoch; anything else is counted and dropped."""
        answer = decode(data)
        if answer is None:
            self.statistics.malformed += 1
        elif answer.seq != self._seq:
            self.statistics.late += 1
        elif answer.status == "OK" and answer.epoch not in self._epochs:
            self.statistics.unknown_epoch += 1
        else:
            self._flags &= ~(RESET | SETTLED)  # the corrector has heard of the new sequence
            return answer
        return None

    def _hold(self, wanted: tuple[float, ...], answer: Answer | None) -> Setpoint:
        """Use the last correction again, or, after too many cycles, release it."""
        status = answer.status if answer is not None else None
        if status is not None:
            self.statistics.refused[status] += 1
        self._misses += 1
        if self._delta and self._misses <= self.hold_cycles:
            self.statistics.held += 1
            return Setpoint(_sum(wanted, self._delta), source="held", wanted=wanted, status=status)
        if not self._delta or self._misses == self.hold_cycles + 1:
            self._begin_fade(self._delta or (0.0,) * len(wanted))
        self._delta = self._faded((0.0,) * len(wanted))
        self.statistics.bypassed += 1
        return Setpoint(_sum(wanted, self._delta), source="bypass", wanted=wanted, status=status)

    def _resume(self, wanted: tuple[float, ...], delta: tuple[float, ...], answer: Answer, trip: float) -> Setpoint:
        """Take a correction over; after a bypass it fades in from where the release had got to."""
        if self._misses > self.hold_cycles and self._delta:
            self._begin_fade(tuple(old - new for old, new in zip(self._delta, delta, strict=True)))
        self._misses = 0
        self._delta = self._faded(delta)
        return Setpoint(
            _sum(wanted, self._delta), source="corrected", wanted=wanted, status="OK", flags=answer.flags,
            round_trip_s=trip,
        )  # fmt: skip

    def _begin_fade(self, offset: tuple[float, ...]) -> None:
        """From here on ``offset`` is added to the correction and fades out."""
        self._offset, self._fade_ns = offset, time.monotonic_ns()

    def _faded(self, delta: tuple[float, ...]) -> tuple[float, ...]:
        """``delta`` plus what is left of the offset."""
        if not self._offset:
            return delta
        left = 1.0 - (time.monotonic_ns() - self._fade_ns) * 1e-9 / self.release_s
        if left <= 0.0:
            self._offset = ()
            return delta
        return tuple(a + left * b for a, b in zip(delta, self._offset, strict=True))


def _sum(a: Sequence[float], b: Sequence[float]) -> tuple[float, ...]:
    return tuple(x + y for x, y in zip(a, b, strict=True))


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
