"""The ROS 2 adaptor beside a peer that speaks as rmw_zenoh does: its keys, attachments and tokens, and rosbags' CDR.

There is no ROS here. What rmw_zenoh expects is written down once more below, from its own documentation, so that nothing
of the adaptor is compared with itself.
"""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import zenoh
from pydantic import ValidationError
from rosbags.typesys import Stores, get_typestore

from kilter_core.correct.program import Track, compile_program
from kilter_core.model import Calibration
from kilter_service.ground.db import Database, revision
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.stream import ros2_process as names
from kilter_service.stream.corrector.session import config, with_free_port
from kilter_service.stream.ros2_process import follow, run
from tests.corrector.live import until

STORE = get_typestore(Stores.ROS2_JAZZY)
STATE, TRAJECTORY = "sensor_msgs/msg/JointState", "trajectory_msgs/msg/JointTrajectory"
ROBOT = "katana450-chapter4"
TOPICS = {"joint_state": ("/arm/wanted", "/arm/commands"), "joint_trajectory": ("/plan", "/arm/joint_trajectory")}
JOINTS = ("a1", "a2", "a3", "a4", "a5")
Q = np.array([0.1, 0.6, 0.4, 0.3, 0.2])
GID = bytes(range(16))
# Stamps, in seconds, of messages that must not come back, and of the one sent behind them.
WRONG, LAST = 70_000, 80_000


def key(topic: str, kind: str) -> str:
    package, _, message = kind.split("/")
    return f"7{topic}/{package}::msg::dds_::{message}_/{STORE.hash_rihs01(kind)}"


def made(kind: str, **fields: object) -> object:
    return STORE.types[kind](**fields)


def header(sec: int = 0) -> object:
    stamp = made("builtin_interfaces/msg/Time", sec=sec, nanosec=0)
    return made("std_msgs/msg/Header", stamp=stamp, frame_id="world")


class RosPeer:
    """A ROS process as zenoh sees it: a peer at the router."""

    def __init__(self, router: str) -> None:
        self.session = zenoh.open(config("tcp/127.0.0.1:0", (router,)))
        self.heard: list[tuple[bytes, bytes | None]] = []
        self._seq: dict[str, int] = {}
        self._publishers: dict[str, zenoh.Publisher] = {}

    def listen(self, key: str) -> None:
        def take(sample: zenoh.Sample) -> None:
            self.heard.append((sample.payload.to_bytes(), sample.attachment and sample.attachment.to_bytes()))

        self.session.declare_subscriber(key, zenoh.handlers.Callback(take, indirect=False))

    def publish(self, key: str, kind: str, message: object, gid: bytes | None = GID) -> None:
        if key not in self._publishers:
            self._publishers[key] = self.session.declare_publisher(key)
            until(lambda: self._publishers[key].matching_status.matching)
        self._seq[key] = self._seq.get(key, 0) + 1
        attachment = None if gid is None else struct.pack("<qqB16s", self._seq[key], time.time_ns(), 16, gid)
        self._publishers[key].put(bytes(STORE.serialize_cdr(message, kind)), attachment=attachment)

    def answer(self, count: int, kind: str) -> object:
        until(lambda: len(self.heard) >= count)
        return STORE.deserialize_cdr(self.heard[count - 1][0], kind)


@pytest.fixture(scope="module")
def router() -> Iterator[str]:
    endpoint = with_free_port("tcp/127.0.0.1:0")
    made = config(endpoint)
    made.insert_json5("mode", '"router"')
    with zenoh.open(made):
        yield endpoint


@pytest.fixture(params=["rmw_zenoh", "ros2dds"])
def dialect(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def adaptor(dialect: str, router: str, source: object, tmp_path: Path) -> Iterator[None]:
    settings = Settings(
        data=tmp_path, site="ros", ros2={ROBOT: {**TOPICS, "joints": JOINTS}}, ros2_domain=7, ros2_connect=router,
        ros2_dialect=dialect,
    )  # fmt: skip
    ended = threading.Event()
    thread = threading.Thread(target=follow, args=(settings, source, ended.wait))
    thread.start()
    yield
    ended.set()
    thread.join(20)
    assert not thread.is_alive()


@pytest.fixture
def ros(router: str) -> Iterator[RosPeer]:
    peer = RosPeer(router)
    yield peer
    peer.session.close()


def keys_of(dialect: str, kind: str) -> tuple[str, str]:
    pair = TOPICS["joint_state" if kind == STATE else "joint_trajectory"]
    wanted, corrected = (key(topic, kind) if dialect == "rmw_zenoh" else topic[1:] for topic in pair)
    return wanted, corrected


def state(q: np.ndarray, sec: int = 0) -> object:
    """In another order than the robot's, with a gripper."""
    order = [4, 0, 1, 3, 2]
    return made(
        STATE, header=header(sec), name=["grip", *(JOINTS[k] for k in order)],
        position=np.concatenate([[0.02], q[order]]), velocity=np.zeros(0), effort=np.arange(6.0),
    )  # fmt: skip


def stamps(ros: RosPeer) -> list[int]:
    return [STORE.deserialize_cdr(data, STATE).header.stamp.sec for data, _ in ros.heard]


def send_until_heard(ros: RosPeer, wanted: str, message: Callable[[int], object], answers: int = 1) -> None:
    """The adaptor has no version for its first moments, and says nothing then."""
    sent = [0]

    def heard() -> bool:
        sent[0] += 1
        ros.publish(wanted, STATE, message(sent[0]))
        return len(ros.heard) >= answers

    until(heard)


@pytest.mark.usefixtures("adaptor")
def test_a_joint_state_comes_back_corrected(dialect: str, ros: RosPeer) -> None:
    wanted, corrected = keys_of(dialect, STATE)
    ros.listen(corrected)
    # The correction ramps in; on a busy machine some messages are too old when they arrive, and none of those comes back.
    send_until_heard(ros, wanted, lambda k: state(Q, k), answers=100)
    out = STORE.deserialize_cdr(ros.heard[-1][0], STATE)
    assert out.name == ["grip", "a5", "a1", "a2", "a4", "a3"]
    assert out.header.frame_id == "world"
    assert out.position[0] == 0.02
    assert np.array_equal(out.effort, np.arange(6.0))
    delta = out.position[1:] - Q[[4, 0, 1, 3, 2]]
    assert 1e-5 < np.max(np.abs(delta)) < 0.02
    if dialect == "rmw_zenoh":
        attachments = [struct.unpack("<qqB16s", a) for _, a in ros.heard if a is not None]
        assert [a[0] for a in attachments] == list(range(1, len(ros.heard) + 1))
        assert {a[2] for a in attachments} == {16}
        assert len({a[3] for a in attachments}) == 1
        assert abs(attachments[-1][1] - time.time_ns()) < 60e9


@pytest.mark.usefixtures("adaptor")
def test_a_trajectory_comes_back_as_the_kernel_corrects_it(dialect: str, ros: RosPeer, katana: Calibration) -> None:
    wanted, corrected = keys_of(dialect, TRAJECTORY)
    ros.listen(corrected)
    t = np.arange(50) * 0.02
    q = Q + 0.1 * np.sin(t)[:, None]
    empty = np.zeros(0)
    points = [
        made(
            "trajectory_msgs/msg/JointTrajectoryPoint", positions=row, velocities=empty, accelerations=empty,
            effort=empty,
            time_from_start=made("builtin_interfaces/msg/Duration", sec=0, nanosec=round(at * 1e9)),
        )
        for at, row in zip(t, q, strict=True)
    ]  # fmt: skip
    message = made(TRAJECTORY, header=header(), joint_names=list(JOINTS), points=points)

    def heard() -> bool:
        ros.publish(wanted, TRAJECTORY, message)
        return bool(ros.heard)

    until(heard)
    out = ros.answer(1, TRAJECTORY)
    track = Track(compile_program(katana), settled=True)
    done, expected, _, _ = track.follow(q, 1, np.diff(t, prepend=t[:1]))
    assert done == len(t)
    got = np.array([point.positions for point in out.points])  # type: ignore[attr-defined]
    assert np.max(np.abs(got - expected)) < 1e-12
    assert [point.time_from_start for point in out.points] == [p.time_from_start for p in points]  # type: ignore[attr-defined]


@pytest.mark.parametrize("dialect", ["rmw_zenoh"], indirect=True)
@pytest.mark.usefixtures("adaptor")
def test_what_cannot_be_corrected_is_counted_and_not_passed_on(dialect: str, ros: RosPeer) -> None:
    wanted, corrected = keys_of(dialect, STATE)
    counters: dict[str, int] = {}

    def take(sample: zenoh.Sample) -> None:
        counters.update(json.loads(sample.payload.to_bytes())["counters"])

    status = f"kilter/@v1/ros/{ROBOT}/stream/ros2_joint_state/status"
    ros.session.declare_subscriber(status, zenoh.handlers.Callback(take, indirect=False))
    ros.listen(corrected)
    send_until_heard(ros, wanted, lambda k: state(Q, k))
    nameless, broken = state(Q, WRONG), state(Q, WRONG)
    nameless.name[2] = "grip"  # type: ignore[attr-defined]
    broken.position[3] = np.nan  # type: ignore[attr-defined]

    def refused() -> bool:
        ros.publish(wanted, STATE, state(Q, WRONG), gid=None)
        ros.publish(wanted, STATE, state(Q, WRONG), gid=bytes(16))
        ros.publish(wanted, STATE, nameless)
        for k in range(3):  # the stream goes on from the numbers that are missing now
            ros.publish(wanted, STATE, state(Q, k))
        ros.publish(wanted, STATE, broken)
        return {"ATTACHMENT", "OTHER_PUBLISHER", "JOINT_NAMES", "NOT_FINITE"} <= set(counters)

    until(refused)

    def passed() -> bool:
        ros.publish(wanted, STATE, state(Q, LAST))
        return LAST in stamps(ros)

    until(passed)
    assert WRONG not in stamps(ros)


@pytest.mark.parametrize("dialect", ["rmw_zenoh"], indirect=True)
@pytest.mark.usefixtures("adaptor")
def test_ros_sees_a_node_with_its_topics(ros: RosPeer) -> None:
    found: set[str] = set()

    def seen() -> bool:
        replies = ros.session.liveliness().get("@ros2_lv/7/**", timeout=2.0)
        found.update(str(reply.ok.key_expr) for reply in replies if reply.ok)
        return len(found) >= 5

    until(seen)
    parts = [token.split("/") for token in found]
    assert {(p[5], p[8]) for p in parts if len(p) == 9} == {("NN", "kilter")}
    topics = {(p[5], p[9], p[10], p[11]) for p in parts if len(p) == 13}
    state_type = ("sensor_msgs::msg::dds_::JointState_", STORE.hash_rihs01(STATE))
    assert ("MS", "%arm%wanted", *state_type) in topics
    assert ("MP", "%arm%commands", *state_type) in topics
    assert len(topics) == 4


def test_hashes_are_those_of_rosbags() -> None:
    assert names.JOINT_STATE.rihs01 == STORE.hash_rihs01(STATE)
    assert names.JOINT_TRAJECTORY.rihs01 == STORE.hash_rihs01(TRAJECTORY)


def test_the_attachment_is_what_zenoh_serializes() -> None:
    from zenoh.ext import Int64, z_serialize

    ours = names.Attachment(3, 1_700_000_000_000_000_000, GID)
    theirs = z_serialize((Int64(3), Int64(1_700_000_000_000_000_000), GID)).to_bytes()
    assert ours.encode() == theirs
    assert names.decode_attachment(theirs) == ours
    assert names.decode_attachment(theirs[:-1]) is None


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"joint_state": ("/a", "/a")}, "different topics"),
        ({"joint_state": ("a", "/b")}, "full topic name"),
        ({}, "joint_state or joint_trajectory"),
    ],
)
def test_wrong_topics_are_refused_with_the_remedy(given: dict[str, object], said: str, tmp_path: Path) -> None:
    with pytest.raises(ValidationError, match=said):
        Settings(data=tmp_path, ros2={ROBOT: given})  # type: ignore[dict-item]


def test_settings_reach_a_child_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given = Settings(data=tmp_path, ros2={ROBOT: TOPICS}, ros2_domain=3)  # type: ignore[dict-item]
    for name, value in given.environment().items():
        monkeypatch.setenv(name, value)
    assert Settings() == given


def test_the_command_runs_on_a_new_database_and_stops_when_told(router: str, ros: RosPeer, tmp_path: Path) -> None:
    settings = Settings(data=tmp_path, site="cmd", ros2={ROBOT: TOPICS}, ros2_domain=7, ros2_connect=router)  # type: ignore[dict-item]
    environment = {**os.environ, **settings.environment()}
    database = Database(settings.database)
    revision.migrate(database)
    database.close()
    heard: list[dict[str, object]] = []

    def take(sample: zenoh.Sample) -> None:
        heard.append(json.loads(sample.payload.to_bytes()))

    status = f"kilter/@v1/cmd/{ROBOT}/stream/ros2_joint_state/status"
    ros.session.declare_subscriber(status, zenoh.handlers.Callback(take, indirect=False))
    command = [sys.executable, "-m", "kilter_service", "ros2"]
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as process:
        try:
            ros.publish(key("/arm/wanted", STATE), STATE, state(Q))
            until(lambda: bool(heard))
        finally:
            process.terminate()
            _, said = process.communicate(timeout=20)
    assert process.returncode == 0, said
    assert heard[0]["counters"] == {"NO_VERSION": 1}
    assert "/arm/wanted of katana450-chapter4 is corrected to /arm/commands" in said


def test_without_topics_the_command_names_the_setting(tmp_path: Path) -> None:
    with pytest.raises(ServiceError, match="KILTER_ROS2"):
        run(Settings(data=tmp_path))
