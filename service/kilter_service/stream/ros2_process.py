"""`kilterd ros2`: corrects messages of ROS 2 that travel over rmw_zenoh or zenoh-bridge-ros2dds.

Apart from the corrector, so that neither can hurt the other: it reads the active versions itself and connects to the
router of ROS as a client.
"""

from __future__ import annotations

import hashlib
import json
import logging
import struct
import threading
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import zenoh

from kilter_core.correct import side_by_side, walk_from_rest, warm_up
from kilter_core.errors import ObservationError
from kilter_core.types import Floats
from kilter_service.ground.child_process import stop_event
from kilter_service.ground.db.failures import Failing
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.stream import ros2_messages
from kilter_service.stream.corrector import endpoints, wire
from kilter_service.stream.corrector.active import Active, DatabaseSource, VersionSource
from kilter_service.stream.corrector.endpoints import check_ros2
from kilter_service.stream.corrector.session import close, config
from kilter_service.stream.corrector.stream import Stream
from kilter_service.stream.corrector.wire import Flag, Status
from kilter_service.web.pulse import Pulse

_ATTACHMENT = struct.Struct("<qqB16s")
NODE = "kilter"
# Reliable, volatile, the last ten: what a ROS 2 publisher or subscription has unless it says otherwise.
QOS = "::,10:,:,:,,"


@dataclass(frozen=True)
class MessageType:
    """A type of ROS 2 with the hash of its definition (REP 2016), which never changes."""

    name: str
    rihs01: str

    @property
    def dds(self) -> str:
        """Name of the type on the wire."""
        package, _, kind = self.name.partition("/")
        return f"{package}::msg::dds_::{kind}_"


JOINT_STATE = MessageType(
    "sensor_msgs/JointState", "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
)
JOINT_TRAJECTORY = MessageType(
    "trajectory_msgs/JointTrajectory", "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e"
)


def rmw_key(domain: int, topic: str, message: MessageType) -> str:
    """Key on which rmw_zenoh publishes a topic."""
    return f"{domain}/{topic.strip('/')}/{message.dds}/{message.rihs01}"


def rmw_keys(domain: int, topic: str, message: MessageType) -> str:
    """Key expression of a topic whatever the publisher says of the type's hash."""
    return f"{domain}/{topic.strip('/')}/{message.dds}/*"


def bridge_key(topic: str) -> str:
    """Key under which zenoh-bridge-ros2dds carries a topic."""
    return topic.strip("/")


def node_token(domain: int, zid: str) -> str:
    """Liveliness token of the node, for ``ros2 node list``."""
    return f"@ros2_lv/{domain}/{zid}/0/0/NN/%/%/{NODE}"


def topic_token(domain: int, zid: str, entity: int, kind: str, topic: str, message: MessageType) -> str:
    """Liveliness token of a publisher (kind "MP") or subscription ("MS"), for ``ros2 topic list`` and ``info``."""
    where = f"@ros2_lv/{domain}/{zid}/0/{entity}/{kind}/%/%/{NODE}"
    return f"{where}/{topic.replace('/', '%')}/{message.dds}/{message.rihs01}/{QOS}"


def publisher_gid(token: str) -> bytes:
    """16 bytes that identify a publisher; any constant ones will do."""
    return hashlib.blake2b(token.encode(), digest_size=16).digest()


class Attachment(NamedTuple):
    """What rmw_zenoh sends along: number of the message, time of sending (ns since 1970), publisher."""

    seq: int
    sent_ns: int
    gid: bytes

    def encode(self) -> bytes:
        """33 bytes; a ROS process that gets others throws the message away, or worse."""
        return _ATTACHMENT.pack(self.seq, self.sent_ns, len(self.gid), self.gid)


def decode_attachment(data: bytes | None) -> Attachment | None:
    """Read an attachment; None when it is not one."""
    if data is None or len(data) != _ATTACHMENT.size:
        return None
    seq, sent_ns, size, gid = _ATTACHMENT.unpack(data)
    return Attachment(seq, sent_ns, gid) if size == len(gid) and seq >= 0 and sent_ns >= 0 else None


# Messages of ROS 2 in, corrected messages out; by the same rules as the stream and the trajectory query.
#
# A message that cannot be corrected is counted and not passed on: ROS has no status beside the numbers, and
# uncorrected numbers on the corrected topic would be the wrong ones.

OTHER_PUBLISHER_NS = 1_000_000_000  # a second publisher is followed when the first was silent for this long


class RefusedError(Exception):
    """A message that is not passed on; its text is the name under which it is counted."""


def joint_columns(names: Sequence[str], joints: Sequence[str]) -> list[int]:
    """Where in the message each joint of the robot is.

    Raises:
        RefusedError: a joint is missing or named twice.

    """
    if not joints or any(names.count(joint) != 1 for joint in joints):
        raise RefusedError("JOINT_NAMES")
    return [names.index(joint) for joint in joints]


class Relay(ABC):
    """One topic on its way: corrects its messages, and counts what became of them."""

    def __init__(self, joints: Sequence[str] = ()) -> None:
        self.counts: Counter[str] = Counter()
        self._joints = tuple(joints)

    def answer(
        self, data: bytes, attachment: Attachment | None, arrival_ns: int, active: Active | None
    ) -> bytes | None:
        """Corrected message; None: it is not corrected."""
        try:
            out = self._correct_message(data, attachment, arrival_ns, active)
        except ros2_messages.CdrError:
            self.counts[Status.BAD_FRAME.name] += 1
        except RefusedError as refused:
            self.counts[str(refused)] += 1
        else:
            self.counts[Status.OK.name] += 1
            return out
        return None

    @abstractmethod
    def _correct_message(
        self, data: bytes, attachment: Attachment | None, arrival_ns: int, active: Active | None
    ) -> bytes:
        """The message with corrected joints; velocities, accelerations and efforts stay as they are."""


class StateRelay(Relay):
    """Setpoints as ``JointState``, one by one; other joints in the message, such as a gripper's, pass unchanged."""

    def __init__(self, joints: Sequence[str] = ()) -> None:
        super().__init__(joints)
        self._stream = Stream()
        self._gid: bytes | None = None
        self._heard_ns = 0
        self._seq = 0

    def _correct_message(
        self, data: bytes, attachment: Attachment | None, arrival_ns: int, active: Active | None
    ) -> bytes:
        state = ros2_messages.decode_joint_state(data)
        if active is None:
            raise RefusedError(Status.NO_VERSION.name)
        columns = joint_columns(state.head.names, self._joints or active.joint_names)
        if len(state.position) != len(state.head.names):
            raise ros2_messages.CdrError("every joint needs a position")
        flags = self._follow_publisher(attachment, arrival_ns)
        values = state.position[columns]
        if len(state.velocity) == len(state.position):
            values = np.concatenate([values, state.velocity[columns]])
            flags |= Flag.QD
        sec, nanosec = state.head.stamp
        stamp = max(0, sec * 1_000_000_000 + nanosec)
        self._seq = attachment.seq if attachment else self._seq + 1
        sent = attachment.sent_ns if attachment else (stamp or arrival_ns)
        frame = wire.encode_setpoints(
            values[None], joints=len(columns), seq=self._seq, t_send_ns=sent, t_apply_ns=0, flags=flags
        )
        raw = self._stream.answer(frame, arrival_ns, active)
        answer = wire.decode_answer(raw) if raw else None
        if answer is None or answer.status != Status.OK:
            raise RefusedError(answer.status.name if answer else Status.BAD_FRAME.name)
        position = state.position.copy()
        position[columns] = answer.values[0]
        return ros2_messages.encode_joint_state(replace(state, position=position))

    def _follow_publisher(self, attachment: Attachment | None, arrival_ns: int) -> int:
        """Flags of this frame: a new publisher begins a sequence. Two at once would move the arm between them."""
        gid = attachment.gid if attachment else b""
        if gid != self._gid:
            if self._gid is not None and arrival_ns - self._heard_ns < OTHER_PUBLISHER_NS:
                raise RefusedError("OTHER_PUBLISHER")
            self._gid, self._heard_ns = gid, arrival_ns
            return int(Flag.RESET)
        self._heard_ns = arrival_ns
        return 0


class TrajectoryRelay(Relay):
    """Whole motions as ``JointTrajectory``: the arm rests at the first point, every point is corrected or none."""

    def _correct_message(
        self, data: bytes, attachment: Attachment | None, arrival_ns: int, active: Active | None
    ) -> bytes:
        trajectory = ros2_messages.decode_joint_trajectory(data)
        if active is None:
            raise RefusedError(Status.NO_VERSION.name)
        positions = corrected_positions(trajectory, active, self._joints or active.joint_names)
        return ros2_messages.encode_joint_trajectory(replace(trajectory, positions=positions))


def corrected_positions(trajectory: ros2_messages.JointTrajectory, active: Active, joints: Sequence[str]) -> Floats:
    """Positions (N, J) as the trajectory query gives them; ``joints`` are the names of the robot's.

    Raises:
        RefusedError: joints missing, times that go back, or a point that is refused.

    """
    names = trajectory.head.names
    columns = joint_columns(names, joints)
    if trajectory.positions.shape[1] != len(names):
        if not len(trajectory.time):
            return trajectory.positions  # the empty trajectory tells a controller to stop
        raise RefusedError(Status.BAD_FRAME.name)
    motion = (trajectory.velocities, trajectory.accelerations)
    qd, qdd = (part[:, columns] if part.shape[1] == len(names) else None for part in motion)
    values, width = side_by_side(trajectory.positions[:, columns], qd, qdd)
    try:
        walked = walk_from_rest(active.program, values, width, trajectory.t)
    except ObservationError as error:
        raise RefusedError(Status.SEQ_BACK.name) from error
    if walked.refusal is not None:
        raise RefusedError(Status(walked.refusal.status).name)
    positions = trajectory.positions.copy()
    positions[:, columns] = walked.q
    return positions


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
            self._announce(node_token(settings.ros2_domain, self._zid))
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
            key = endpoints.RobotKeys(self._settings.site, route.robot).stream(f"ros2_{route.kind}", "status")
            document = {"wanted": route.wanted, "corrected": route.corrected, "counters": counts}
            self._session.put(key, json.dumps(document).encode(), encoding=zenoh.Encoding.APPLICATION_JSON)

    def _announce(self, token: str) -> None:
        self._tokens.append(self._session.liveliness().declare_token(token))

    def _relay(self, route: Route, entity: int) -> None:
        domain = self._settings.ros2_domain
        if self._rmw:
            wanted = rmw_keys(domain, route.wanted, route.message)
            corrected = rmw_key(domain, route.corrected, route.message)
            token = topic_token(domain, self._zid, entity + 1, "MP", route.corrected, route.message)
            self._announce(topic_token(domain, self._zid, entity, "MS", route.wanted, route.message))
            self._announce(token)
            gid = publisher_gid(token)
        else:
            wanted, corrected, gid = bridge_key(route.wanted), bridge_key(route.corrected), b""
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
        attachment = decode_attachment(sample.attachment.to_bytes() if sample.attachment else None)
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
    ended = stop_event()
    source = DatabaseSource(settings.database, settings.temperature_c, settings.data)
    try:
        follow(settings, source, ended.wait)
    finally:
        source.close()
