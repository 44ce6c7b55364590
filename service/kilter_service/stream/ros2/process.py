"""`kilterd ros2`: corrects messages of ROS 2 that travel over rmw_zenoh or zenoh-bridge-ros2dds.

Apart from the corrector, so that neither can hurt the other: it reads the active versions itself and connects to the
router of ROS as a client.
"""

from __future__ import annotations

import json
import logging
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FrameType

import zenoh

from kilter_core.correct.program import warm_up
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.failure_log import Failing
from kilter_service.ground.settings import Settings
from kilter_service.stream.corrector import keys
from kilter_service.stream.corrector.active import Active, VersionSource
from kilter_service.stream.corrector.database_source import DatabaseSource
from kilter_service.stream.corrector.endpoints import check_ros2
from kilter_service.stream.corrector.session import close, config
from kilter_service.stream.ros2 import names
from kilter_service.stream.ros2.names import JOINT_STATE, JOINT_TRAJECTORY, Attachment, MessageType
from kilter_service.stream.ros2.relay import Relay, StateRelay, TrajectoryRelay
from kilter_service.web.health.pulse import Pulse

log = logging.getLogger("kilter.ros2")

POLL_S = 0.25
RETRY_S = 1.0


@dataclass(frozen=True)
class Route:
    """One topic to another for one robot."""

    robot: str
    kind: str
    wanted: str
    corrected: str
    message: MessageType
    relay: Relay


def routes(settings: Settings) -> list[Route]:
    """What the settings ask for."""
    made = []
    for robot, topics in settings.ros2.items():
        if topics.joint_state:
            made.append(Route(robot, "joint_state", *topics.joint_state, JOINT_STATE, StateRelay(topics.joints)))
        if topics.joint_trajectory:
            relay = TrajectoryRelay(topics.joints)
            made.append(Route(robot, "joint_trajectory", *topics.joint_trajectory, JOINT_TRAJECTORY, relay))
    return made


class Adaptor:
    """Relays every route of one zenoh session until it closes."""

    def __init__(self, session: zenoh.Session, settings: Settings) -> None:
        self.active: dict[str, Active] = {}
        self._session = session
        self._settings = settings
        self._zid = str(session.info.zid())
        self._rmw = settings.ros2_dialect == "rmw_zenoh"
        self._tokens: list[zenoh.LivelinessToken] = []
        self._said: dict[str, dict[str, int]] = {}
        self.routes = routes(settings)
        if self._rmw:
            self._announce(names.node_token(settings.ros2_domain, self._zid))
        self._threads = [
            threading.Thread(target=self._relay, args=(route, 10 * (k + 1)), name=route.corrected)
            for k, route in enumerate(self.routes)
        ]

    def start(self) -> None:
        """Take messages from here on."""
        for thread in self._threads:
            thread.start()

    def join(self) -> None:
        """Wait for the threads, which end when the session is closed."""
        for thread in self._threads:
            thread.join()

    def report(self) -> None:
        """Publish and log counters that changed."""
        for route in self.routes:
            counts = dict(route.relay.counts)
            before = self._said.get(f"{route.robot}/{route.kind}", {})
            if counts == before:
                continue
            self._said[f"{route.robot}/{route.kind}"] = counts
            refused = {k: n - before.get(k, 0) for k, n in counts.items() if k != "OK" and n != before.get(k, 0)}
            if refused:
                log.warning("%s: not corrected and not passed on: %s", route.wanted, refused)
            key = keys.RobotKeys(self._settings.site, route.robot).stream(f"ros2_{route.kind}", "status")
            document = {"wanted": route.wanted, "corrected": route.corrected, "counters": counts}
            self._session.put(key, json.dumps(document).encode(), encoding=zenoh.Encoding.APPLICATION_JSON)

    def _announce(self, token: str) -> None:
        self._tokens.append(self._session.liveliness().declare_token(token))

    def _relay(self, route: Route, entity: int) -> None:
        domain = self._settings.ros2_domain
        if self._rmw:
            wanted = names.rmw_keys(domain, route.wanted, route.message)
            corrected = names.rmw_key(domain, route.corrected, route.message)
            token = names.topic_token(domain, self._zid, entity + 1, "MP", route.corrected, route.message)
            self._announce(names.topic_token(domain, self._zid, entity, "MS", route.wanted, route.message))
            self._announce(token)
            gid = names.publisher_gid(token)
        else:
            wanted, corrected, gid = names.bridge_key(route.wanted), names.bridge_key(route.corrected), b""
        subscriber = self._session.declare_subscriber(wanted, zenoh.handlers.RingChannel(256))
        publisher = self._session.declare_publisher(
            corrected, priority=zenoh.Priority.REAL_TIME, congestion_control=zenoh.CongestionControl.DROP, express=False
        )
        seq = 0
        for sample in _samples(subscriber):
            out = self._answer(route, sample)
            if out is None:
                continue
            seq += 1
            attachment = Attachment(seq, time.time_ns(), gid).encode() if self._rmw else None
            try:
                publisher.put(out, attachment=attachment)
            except zenoh.ZError:  # the session was closed meanwhile
                return

    def _answer(self, route: Route, sample: zenoh.Sample) -> bytes | None:
        arrival_ns = time.monotonic_ns()
        attachment = names.decode_attachment(sample.attachment.to_bytes() if sample.attachment else None)
        if self._rmw and attachment is None:
            route.relay.counts["ATTACHMENT"] += 1
            return None
        return route.relay.answer(sample.payload.to_bytes(), attachment, arrival_ns, self.active.get(route.robot))


def _samples(subscriber: zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]]) -> Iterator[zenoh.Sample]:
    """Samples until the session is closed."""
    while True:
        try:
            yield subscriber.handler.recv()
        except zenoh.ZError:
            return


def open_router_session(settings: Settings, stopped: Callable[[float], bool]) -> zenoh.Session | None:
    """A session with the router of ROS, tried until there is one; None when stopped first."""
    made = config(None, (settings.ros2_connect,), settings.ros2_zenoh_config)
    made.insert_json5("mode", '"client"')  # a router passes everything on to a client, but not always to a peer
    said = False
    while True:
        try:
            return zenoh.open(made)
        except zenoh.ZError as error:
            if not said:
                log.warning("no router of ROS at %s (%s): it is tried again", settings.ros2_connect, error)
            said = True
            if stopped(RETRY_S):
                return None


class Versions:
    """The active versions, read again when they change."""

    def __init__(self, source: VersionSource) -> None:
        self._source = source
        self._stamp: object = object()
        self._looking = Failing(log, "the active versions cannot be read; the versions in use stay")

    def poll(self) -> dict[str, Active] | None:
        """Versions by robot, or None when they are the same; whatever the database says, those in use stay."""
        try:
            stamp = self._source.stamp()
            if stamp == self._stamp:
                return None
            found = dict(self._source.load())
        except Exception as error:
            self._looking.report_failure(error)
            return None
        self._looking.report_success()
        self._stamp = stamp
        return found


def follow(settings: Settings, source: VersionSource, stopped: Callable[[float], bool]) -> None:
    """Relay, and follow the active versions, until ``stopped(seconds)`` says so."""
    warm_up()
    session = open_router_session(settings, stopped)
    if session is None:
        return
    adaptor, versions = Adaptor(session, settings), Versions(source)
    try:
        adaptor.start()
        for route in adaptor.routes:
            log.info("%s of %s is corrected to %s", route.wanted, route.robot, route.corrected)
        with Pulse(settings, "ros2", settings.site) as pulse:
            while True:
                found = versions.poll()
                if found is not None:
                    adaptor.active = found
                adaptor.report()
                pulse.round()
                if stopped(POLL_S):
                    return
    finally:
        close(session)
        adaptor.join()


def run(settings: Settings) -> None:
    """Relay until SIGTERM or Ctrl-C.

    Raises:
        ServiceError: no topics are set, or the router is elsewhere without TLS.

    """
    if not settings.ros2:
        raise ServiceError(
            "No topics are set: give KILTER_ROS2, as docs/how-to/use-ros2.md shows.", code="option_invalid"
        )
    check_ros2(settings)
    ended = threading.Event()

    def stop(_signal: int, _frame: FrameType | None) -> None:
        ended.set()

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    source = DatabaseSource(settings.database, settings.temperature_c, settings.data)
    try:
        follow(settings, source, ended.wait)
    finally:
        source.close()
