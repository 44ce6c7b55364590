"""The stream process: one session, one ring of samples, one thread that corrects; a second one does the housekeeping.

Nothing else runs here: 10 ms of Python elsewhere in the process would raise the stream's 99th percentile to 6-7 ms.
"""

from __future__ import annotations

import gc
import json
import logging
import os
import select
import signal
import sys
import threading
import time
from collections import deque
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any

import zenoh

from kilter_core.correct import warm_up
from kilter_service.ground.errors import ServiceError
from kilter_service.stream.corrector import endpoints, fast_path, wire
from kilter_service.stream.corrector.active import Active, nothing_active
from kilter_service.stream.corrector.session import ENCODING, ORPHAN_S, Door, State, StreamSpec, close, open_listening
from kilter_service.stream.corrector.slots import (
    Admitted,
    Gate,
    Served,
    Slots,
    address_from_key,
    parse_setpoint_key,
    unsigned_refusal,
)
from kilter_service.stream.corrector.telemetry import PERIOD_S, Telemetry, TurnedAway
from kilter_service.stream.corrector.wire import Status
from kilter_service.stream.signing import sealed, service
from kilter_service.stream.signing.masters import Masters, load_masters

log = logging.getLogger("kilter.corrector.stream")

STATUS_PERIOD_S = 0.5
BETWEEN_WAKE_UPS_NS = 50_000_000  # a verdict that flips at every setpoint must not keep the housekeeping awake
REAL_TIME_PRIORITY = 40


class WakeUp:
    """Wakes the housekeeping thread, which sleeps otherwise: what it does meanwhile would delay a setpoint."""

    def __init__(self) -> None:
        self.waits, self._pull = os.pipe()
        os.set_blocking(self.waits, False)
        os.set_blocking(self._pull, False)

    def signal(self) -> None:
        """Wake it; a signal that was not cleared yet still holds."""
        with suppress(BlockingIOError):
            os.write(self._pull, b"!")

    def clear(self) -> None:
        """Take the signal back."""
        with suppress(BlockingIOError):
            os.read(self.waits, 4096)


class StreamLoop:
    """Takes samples from the ring and publishes answers until the session closes."""

    def __init__(self, session: zenoh.Session, spec: StreamSpec, wake_up: WakeUp) -> None:
        self.session = session
        self.spec = spec
        self.active: dict[str, Active] = {}  # replaced entry by entry: a lookup sees the old version or the new
        self.gate = Gate(spec.masters, spec.unsigned)
        self.slots = Slots(session, spec.rules, self.gate)
        self.turned_away = TurnedAway()
        self._wake_up = wake_up
        self._subscriber = session.declare_subscriber(
            endpoints.every_input(spec.site), zenoh.handlers.RingChannel(spec.rules.ring)
        )

    def run(self) -> None:
        """Correct until the session is closed by the housekeeping thread."""
        ring, most, active, now = self._subscriber.handler, self.spec.rules.ring, self.active, time.monotonic_ns
        backlog, woken_ns = 0, 0
        last: Served | None = None
        while True:
            try:
                sample = ring.try_recv()
                backlog = backlog + 1 if sample is not None else 0
                sample = sample or ring.recv()
            except zenoh.ZError:  # the session was closed
                return
            arrival_ns, key = now(), sample.key_expr
            # Streams come in turn. To compare two keys takes a quarter of the time to make a string and look it up.
            served = last.follower if last is not None else None
            if served is None or served.key != key:
                served = self._find(str(key), sample, arrival_ns, last)
                if served is None:
                    continue
            data = sample.payload.to_bytes()
            answer = served.guard.answer(data, arrival_ns, active.get(served.robot), backlog >= most)
            if answer is not None:
                served.publisher.put(answer)
            last, verdict = served, served.stream.counters.last_status
            if verdict != served.verdict and arrival_ns - woken_ns > BETWEEN_WAKE_UPS_NS:
                served.verdict, woken_ns = verdict, arrival_ns
                self._wake_up.signal()

    def follow(self, masters: Masters) -> None:
        """Take these secrets from here on."""
        self.gate.masters = masters
        for served in self.slots.served.values():
            served.guard.follow()

    def _find(self, key: str, sample: zenoh.Sample, arrival_ns: int, last: Served | None) -> Served | None:
        """The stream of a key, remembered as the one that follows ``last``; None when it was answered without one."""
        served = self.slots.served.get(key) or self._start(key, sample.payload.to_bytes(), arrival_ns)
        if served is None:
            return None
        if last is not None:
            last.follower = served
        served.follower = served.follower or served
        return served

    def _start(self, key: str, data: bytes, arrival_ns: int) -> Served | None:
        """A slot for the first setpoint of a stream. A setpoint that gets none is still answered if it has a header."""
        names = parse_setpoint_key(key)
        if names is None:
            return None
        if data[:4] == sealed.MAGIC:
            return self._start_signed(key, names, data, arrival_ns)
        if not self.gate.unsigned:
            self.gate.dropped["unsigned"] += 1
            self.turned_away.count(names[1], Status.UNSIGNED.name)
            self._put(names[1], unsigned_refusal(data))
            return None
        try:
            header = wire.decode_setpoints(data).header
        except wire.FrameError as error:
            self._refuse(names[1], error.header, Status.BAD_FRAME)
            return None
        served = self.slots.allocate_slot(key, names, arrival_ns) if names[0] in self.active else None
        if served is None:
            self._refuse(names[1], header, Status.OVERLOAD if names[0] in self.active else Status.NO_VERSION)
        return served

    def _start_signed(self, key: str, names: tuple[str, str, str], data: bytes, arrival_ns: int) -> Served | None:
        """A slot for the first signed setpoint of a session; only its key in use gives one."""
        if not sealed.is_signed(data):
            self.gate.dropped["forged"] += 1
            return None
        admitted = self.gate.admit(address_from_key(key), data)
        if not isinstance(admitted, Admitted):
            self._put(names[1], admitted)
            return None
        secret = self.gate.secret
        served = self.slots.allocate_slot(key, names, arrival_ns) if names[0] in self.active else None
        if served is not None:
            if self.gate.secret == secret:  # else another stream lost its slot for this one: ask for a newer frame
                served.guard.adopt(admitted)
            return served
        status = Status.OVERLOAD if names[0] in self.active else Status.NO_VERSION
        self.turned_away.count(names[1], status.name)
        refusal = wire.encode_refusal(wire.decode_header(sealed.strip_signature(data)), status)
        self._put(names[1], sealed.sign_frame(refusal, admitted.session, admitted.key, sealed.ANSWER))
        return None

    def _refuse(self, out: str, header: wire.Header | None, status: Status) -> None:
        self.turned_away.count(out, status.name)
        if header is not None:
            self._put(out, wire.encode_refusal(header, status))

    def _put(self, out: str, answer: bytes | None) -> None:
        if answer is not None:
            self.session.put(
                out,
                answer,
                encoding=zenoh.Encoding(ENCODING),
                priority=zenoh.Priority.REAL_TIME,
                congestion_control=zenoh.CongestionControl.DROP,
            )


class HousekeepingThread(threading.Thread):
    """Takes versions from the corrector, announces them, reports status; closes the session when the corrector says stop.

    When the corrector is gone the stream goes on, and another one finds it through its door.
    """

    def __init__(self, loop: StreamLoop, wake_up: WakeUp, pipe: Connection, door: Door, endpoint: str) -> None:
        super().__init__(name="housekeeping")
        self._loop = loop
        self._wake_up = wake_up
        self._pipe: Connection | None = pipe
        self._door, self._endpoint = door, endpoint
        self._alone_since = 0.0
        self._queries: deque[zenoh.Query] = deque(maxlen=64)
        self._tokens: dict[str, zenoh.LivelinessToken] = {}
        self._reported_s = 0.0
        self._telemetry = Telemetry(loop.session, loop.spec, loop.gate, loop.slots, loop.active, loop.turned_away)
        loop.session.declare_queryable(
            endpoints.every_active(loop.spec.site), zenoh.handlers.Callback(self._queue_query, indirect=False)
        )

    def _queue_query(self, query: zenoh.Query) -> None:
        self._queries.append(query)
        self._wake_up.signal()

    def run(self) -> None:
        """Work until the corrector says stop, or is gone and no other comes."""
        try:
            while self._handle_next_message():
                self._answer_queries()
                self._report()
                self._telemetry.publish_changes()
        except Exception:
            log.exception("the housekeeping of the corrector failed; the process stops and is restarted")
        finally:
            close(self._loop.session)

    def _handle_next_message(self) -> bool:
        """Sleep until there is something to do, and take one message of the corrector; False to stop."""
        pause = PERIOD_S if self._telemetry.watched else STATUS_PERIOD_S
        heard = self._door.socket if self._pipe is None else self._pipe
        ready = wait([heard, self._wake_up.waits], pause)
        self._wake_up.clear()
        if self._pipe is None:
            return self._wait_for_another(came=heard in ready)
        if heard not in ready:
            return True
        try:
            message, *rest = self._pipe.recv()
        except (EOFError, OSError):
            return self._go_on_alone()
        if message == "use":
            self._use(rest[0])
        elif message == "masters":
            self._loop.follow(rest[0])
        elif message == "drop":
            self._drop(rest[0])
        return bool(message != "stop")

    def _go_on_alone(self) -> bool:
        """Go on without the corrector, which was killed: an arm may be moving. False where nobody is corrected yet."""
        self._pipe, self._alone_since = None, time.monotonic()
        if self._loop.active:
            log.error("the corrector that started the stream is gone: the stream goes on for %.0f s", ORPHAN_S)
        return bool(self._loop.active)

    def _wait_for_another(self, came: bool) -> bool:
        """Let a corrector that has come take this process over; False when none came in time, or it wants another."""
        file = self._loop.spec.keys_file
        if file is not None:  # a session that is revoked ends, whoever looks
            with suppress(ServiceError, OSError):
                self._loop.follow(load_masters(file, make=False))
        if came:
            state = State(os.getpid(), self._loop.spec, self._endpoint, dict(self._loop.active))
            taken, self._pipe = self._door.handle_connection(state)
            return taken
        return time.monotonic() - self._alone_since < ORPHAN_S

    def _use(self, active: Active) -> None:
        """Announce the version first, then use it: a controller knows every epoch before it meets it."""
        robot = endpoints.RobotKeys(self._loop.spec.site, active.robot)
        self._announce(active.robot, active.announcement())
        if active.robot not in self._loop.active:
            self._loop.gate.forget()  # frames refused until now must not be the first that are taken
        self._loop.active[active.robot] = active
        if active.robot not in self._tokens:
            liveliness = self._loop.session.liveliness()
            self._tokens[active.robot] = liveliness.declare_token(robot.alive(self._loop.spec.instance))

    def _drop(self, robot: str) -> None:
        self._loop.active.pop(robot, None)
        self._announce(robot, nothing_active(robot))

    def _announce(self, robot: str, document: bytes) -> None:
        spec = self._loop.spec
        key = endpoints.RobotKeys(spec.site, robot).active
        signed = self._loop.gate.masters.sign_announcement(key, spec.site, robot, document)
        self._loop.session.put(
            key,
            signed,
            encoding=zenoh.Encoding.APPLICATION_JSON,
            priority=zenoh.Priority.DATA_HIGH,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )

    def _answer_queries(self) -> None:
        while self._queries:
            with self._queries.popleft() as query:
                found = False
                for active in list(self._loop.active.values()):
                    key = endpoints.RobotKeys(self._loop.spec.site, active.robot).active
                    if zenoh.KeyExpr(key).intersects(query.key_expr):
                        found = True
                        self._reply(query, key, active.robot, active.announcement())
                asked = str(query.key_expr)
                if not found and "*" not in asked:  # so that silence never means that nothing is active
                    robot = endpoints.robot_from_key(asked)
                    self._reply(query, asked, robot, nothing_active(robot))

    def _reply(self, query: zenoh.Query, key: str, robot: str, document: bytes) -> None:
        question = query.payload.to_bytes() if query.payload else b""
        stream = query.parameters.get("stream")
        signed = service.reply(self._loop.gate.masters, question, key, self._loop.spec.site, robot, stream, document)
        query.reply(key, signed, encoding=zenoh.Encoding.APPLICATION_JSON)

    def _report(self) -> None:
        """Publish the status of streams that moved, twice a second, and at once when their verdict changes."""
        due = time.monotonic() - self._reported_s >= STATUS_PERIOD_S
        if due:
            self._reported_s = time.monotonic()
        told: list[dict[str, Any]] = []
        for served in self._loop.slots.served.values():
            counters = served.stream.counters
            now = (counters.last_status, sum(counters.by_status))
            if now == served.reported or not (due or now[0] != served.reported[0]):
                continue
            served.reported = now
            active = self._loop.active.get(served.robot)
            document: dict[str, Any] = {
                "instance": self._loop.spec.instance,
                "version_id": active.version_id if active else None,
                "epoch": active.epoch if active else None,
                **counters.document(),
                "signed": served.guard.is_signed,
                "replayed": served.guard.replayed,
                "dropped": dict(self._loop.gate.dropped),
                "at_ns": time.time_ns(),
            }
            signed = self._loop.gate.masters.sign_announcement(
                served.status_key, self._loop.spec.site, served.robot, json.dumps(document).encode()
            )
            self._loop.session.put(
                served.status_key,
                signed,
                encoding=zenoh.Encoding.APPLICATION_JSON,
                priority=zenoh.Priority.DATA_LOW,
                congestion_control=zenoh.CongestionControl.DROP,
            )
            place = {"robot": served.robot, "stream": endpoints.stream_from_key(served.status_key)}
            told.append({**place, **document, "by_time": counters.by_time, **self._telemetry.latest(served)})
        # A supervisor that does not read must not hold up this thread: then it is not told.
        if told and self._pipe is not None and select.select([], [self._pipe], [], 0)[1]:
            with suppress(OSError):  # it is just ending
                self._pipe.send(("status", told))


def ask_for_real_time() -> bool:
    """SCHED_FIFO for this process where the system allows it: the best single knob for the tail."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REAL_TIME_PRIORITY))
    except (AttributeError, OSError):
        return False
    return True


def stream_main(spec: StreamSpec, pipe: Connection) -> None:
    """Entry of the spawned stream process.

    It reports its endpoint as ("listening", endpoint, real_time), or ("refused", why, False) when it may not listen.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group: the supervisor stops us in order
    sys.setswitchinterval(0.0005)
    warm_up()
    fast_path.warm_up()  # before real time: a first compilation takes seconds
    real_time = ask_for_real_time()
    try:
        session, endpoint = open_listening(spec.listen, spec.zenoh_config, spec.private_endpoint, spec.again)
    except ServiceError as error:
        pipe.send(("refused", error.message, False))
        return
    with session, Door(spec.private_endpoint) as door:
        wake_up = WakeUp()
        loop = StreamLoop(session, spec, wake_up)
        housekeeping = HousekeepingThread(loop, wake_up, pipe, door, endpoint)
        pipe.send(("listening", endpoint, real_time))
        gc.collect()
        gc.freeze()
        gc.disable()
        housekeeping.start()
        try:
            loop.run()
        finally:
            close(session)
            housekeeping.join()
