"""`kilter bridge egm` against a controller with the messages of a public client library: on its path, ramped, bounded."""

from __future__ import annotations

import math
import socket
from pathlib import Path

import numpy as np
import pytest
from ABBRobotEGM._egm_protobuf import egm_pb2

from kilter_client import Kilter
from kilter_client.bridges.egm import EgmWire
from kilter_client.bridges.plan import Heard, Setpoints, Table, read_table
from kilter_client.cli import run
from kilter_client.errors import FileError
from kilter_client.streaming.frames import encode
from tests.clients.bridges.egm_peer import EgmPeer
from tests.clients.bridges.running_bridge import bridging, off_mm, shared_arm
from tests.clients.three_joint_arm import Floats

CYCLE_S, SPEED_DEG_S, RATE_DEG_S = 0.012, 20.0, 2.0
PACE = ["--cycle-ms", "12", "--rate-deg-s", str(RATE_DEG_S), "--ramp-s", "0.5", "--gone-after-s", "2", "--port", "0"]
BEGIN = np.array([0.0, 30.0, 20.0])


def path(t_s: float) -> Floats:
    """A slow motion of three joints that begins at rest."""
    slow = t_s * t_s / (1.0 + t_s)
    return np.array([30 * np.sin(0.4 * slow), 30 + 20 * np.sin(0.5 * slow), 20 + 30 * np.sin(0.3 * slow)])


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture
def arm(kilter: Kilter, tmp_path: Path) -> str:
    return shared_arm(kilter, tmp_path)


def test_the_arm_follows_a_planner_corrected_and_holds_where_the_planner_is_silent(arm: str) -> None:
    port = free_port()
    options = ["--setpoints-port", str(port), "--speed-deg-s", str(SPEED_DEG_S)]
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as planner,
        bridging("egm", arm, *PACE, *options) as bridge,
    ):
        planner.connect(("127.0.0.1", port))
        sent: dict[int, Floats] = {}

        def plan(cycle: int) -> None:
            if not peer.running or stopped:
                return
            sent[cycle] = path((cycle - began[0]) * CYCLE_S)
            planner.send(encode(np.radians(sent[cycle]).tolist(), joints=3, seq=cycle, t_send_ns=0))

        began, stopped = [0], []
        bridge.heard("waiting")
        peer = EgmPeer(bridge.port, BEGIN, each_cycle=plan)
        peer.start()
        try:
            peer.wait(30)
            assert np.array_equal(peer.positions()[-1], BEGIN)
            began[0] = len(peer.rows) + 1
            peer.running = True
            bridge.heard("correcting")
            peer.wait(100)
            until = len(peer.rows)
            stopped.append(True)
            peer.wait(30)
            planner.send(encode(np.radians(path(0) + 40.0).tolist(), joints=3, seq=10**6, t_send_ns=0))  # far away
            planner.send(b"KLT1 is no setpoint")
            peer.wait(10)
            out = bridge.ended()
        finally:
            peer.stop()
    rows = [cycle for cycle in range(until - 40, until - 2) if peer.answered()[cycle]]
    wanted = np.array([sent[cycle] for cycle in rows])
    offsets = peer.positions()[rows] - wanted
    assert off_mm(wanted, 0 * offsets).max() > 0.5
    assert np.median(off_mm(wanted, offsets)) < 0.05  # a setpoint may come a cycle late on a busy machine
    assert np.ptp(peer.positions()[until + 10 : until + 25], axis=0).max() < 1e-3  # held
    step = np.abs(np.diff(peer.positions()[peer.answered()], axis=0)).max(axis=1)
    assert (step / np.diff(np.flatnonzero(peer.answered()))).max() < (SPEED_DEG_S + RATE_DEG_S) * CYCLE_S * 1.001
    assert "plan_too_far: 1" in out
    assert "plan_malformed: 1" in out


def test_the_arm_follows_a_table_from_where_it_stands(arm: str, tmp_path: Path) -> None:
    table = tmp_path / "path.csv"
    rows = [",".join(f"{value:.9f}" for value in (t, *path(t))) for t in np.arange(0.0, 1.5, 0.1)]
    table.write_text("\n".join(["t_s,q1_deg,q2_deg,q3_deg", *rows, ""]))
    with bridging("egm", arm, *PACE, "--path", str(table)) as bridge:
        bridge.heard("waiting")
        peer = EgmPeer(bridge.port, BEGIN, running=True).start()
        try:
            peer.wait(160)
            end = path(1.4)[None]
            there = peer.positions()[-1:] - end
            bridge.ended()
        finally:
            peer.stop()
    assert off_mm(end, 0 * there).max() > 0.5
    assert off_mm(end, there).max() < 0.05


def setpoints(rows: list[list[float]]) -> Setpoints:
    return Setpoints(Table([0.1 * k for k in range(len(rows))], rows), math.radians(10.0), 0.004)


def robot_message(joints: list[float], sequence: int | None = 7) -> bytes:
    robot = egm_pb2.EgmRobot()
    robot.header.tm = 2**32 - 1
    if sequence is not None:
        robot.header.seqno = sequence
    robot.feedBack.joints.joints.extend(joints)
    content: bytes = robot.SerializeToString()
    return content


def test_what_is_no_message_of_a_robot_is_none_and_other_joint_counts_have_no_joints() -> None:
    wire = EgmWire([1.0, -1.0, 1.0], setpoints([[0.0] * 3] * 2))
    good = robot_message([1.0, 2.0, 3.0])
    request = wire.read(good)
    assert request is not None
    assert np.allclose(np.degrees(request.joints or ()), (1.0, -2.0, 3.0))
    assert (request.stamp, request.clock, request.moving) == (7, 2**32 - 1, True)
    assert wire.answer(request, [0.0] * 3) == b""  # nothing is told before it is known where the arm stands
    for wrong in ([1.0, 2.0], [1.0] * 4, [math.nan, 0.0, 0.0], []):
        other = wire.read(robot_message(wrong))
        assert other is not None
        assert other.joints is None
    assert wire.counts["joints_unusable"] == 4
    assert wire.read(robot_message([1.0] * 3, None)) is None
    rng = np.random.default_rng(4)
    for _ in range(3000):
        damaged = bytearray(good)
        for place in rng.integers(len(good), size=3):
            damaged[place] = rng.integers(256)
        wire.read(bytes(damaged[: rng.integers(len(good) + 1)]))


def test_setpoints_are_followed_at_their_speed_and_none_that_is_far() -> None:
    followed = setpoints([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.03, 0.5, 0.0]])
    assert followed.step(1) is None  # nobody knows where the arm stands
    followed.start_from_joints([0.0, 0.0, 0.0])
    steps = np.array([followed.step(1) for _ in range(60)])
    assert np.abs(np.diff(steps, axis=0)).max() <= math.radians(10.0) * 0.004 * (1 + 1e-9)
    assert followed.counts["plan_slowed"] > 0
    assert followed.counts["plan_too_far"] > 0
    assert steps[:, 1].max() < 0.1


@pytest.mark.parametrize("lost", [1, 10, 100])
def test_after_lost_cycles_the_arm_goes_on_from_where_it_stands(lost: int) -> None:
    wire = EgmWire([1.0, 1.0, 1.0], setpoints([[0.01 * k, 0.0, 0.0] for k in range(40)]))
    where, sequence = [], 0
    for k in range(200):
        request = wire.read(robot_message([0.0, 0.0, 0.0], sequence))
        assert request is not None
        cycles = 1 + lost * (k == 100)
        at = wire.wanted_joints(request, cycles, k == 0)
        assert at is not None
        where.append(at)
        sequence += cycles
    steps = np.abs(np.diff(where, axis=0)).max(axis=1)
    assert np.ptp(steps[-60:]) < 1e-9  # at the plan's own speed, through the gap and behind it
    assert steps[-1] == pytest.approx(0.1 * 0.004)


def test_a_planner_that_sends_old_or_other_messages_is_not_followed() -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as planner,
    ):
        port.bind(("127.0.0.1", 0))
        planner.connect(port.getsockname())
        heard = Heard(port, 3)
        heard.restart_plan()
        good = {seq: encode([seq / 10, 0.0, 0.0], joints=3, seq=seq, t_send_ns=0) for seq in (1, 2, 3)}
        planner.send(good[2])
        assert heard.next_setpoint(0.0) == (0.2, 0.0, 0.0)
        assert heard.next_setpoint(0.0) is None
        wrong = [encode([0.1] * 2, joints=2, seq=9, t_send_ns=0), encode([math.nan] * 3, joints=3, seq=9, t_send_ns=0)]
        for content in (good[1], good[2], *wrong, b"", good[3][:-1]):
            planner.send(content)
        assert heard.next_setpoint(0.0) is None
        assert dict(heard.counts) == {"plan_old": 2, "plan_malformed": 4}
        limited = Heard(port, 3, [(None, None), (-90.0, 90.0), (None, 10.0)])
        for seq, q in ((4, [0.1, 1.6, 0.0]), (5, [0.1, 0.0, 0.2])):
            planner.send(encode(q, joints=3, seq=seq, t_send_ns=0))
            assert limited.next_setpoint(0.0) is None
        assert dict(limited.counts) == {"plan_beyond_limits": 2}
        planner.send(good[3])
        assert heard.next_setpoint(0.0) == (0.3, 0.0, 0.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t_s,q1_deg\n0,1\n1,2\n", "line 2: has no column q2_deg: give t_s, q1_deg, q2_deg in every row"),
        ("t_s,q1_deg,q2_deg\n0,1,2\n1,x,3\n", "line 3: has 'x' in q1_deg"),
        ("t_s,q1_deg,q2_deg\n0,1,2\n1,2\n", "line 3: has no number in q2_deg"),
        ("t_s,q1_deg,q2_deg\n0,1,2\n1,,2\n", "line 3: has no number in q1_deg"),
        ("t_s,q1_deg,q2_deg\n0,1,2\n0,2,3\n", "line 3"),
        ("t_s,q1_deg,q2_deg\n0,1,2\n1,nan,3\n", "line 3"),
        ("t_s,q1_deg,q2_deg\n0,1,2\n", "fewer than two"),
        (
            "t_s,q1_deg,q2_deg\n0,1,2\n1,1,999\n",
            "line 3: q2_deg is 999, beyond the limits of joint 2",
        ),
    ],
)
def test_a_table_that_is_none_is_refused_with_its_place(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "path.csv"
    path.write_text(text)
    with pytest.raises(FileError, match=said):
        read_table(path, [(None, None), (-90.0, 90.0)])


def test_one_source_of_setpoints_must_be_named(arm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["bridge", "egm", arm]) == 2
    assert "--path FILE, or --setpoints-port" in capsys.readouterr().err
