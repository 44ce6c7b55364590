"""`kilter bridge rsi` against a controller of its own: corrected, ramped, bounded, and harmless whatever becomes of it."""

from __future__ import annotations

import json
import re
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import zenoh

from kilter_client import Kilter
from kilter_client.bridges.correction import Followed, Kind, fetch_startup_version, poll_server
from kilter_client.cli import run
from kilter_client.errors import ConflictError, NotFoundError
from kilter_client.streaming.certificates import session_config
from kilter_core.correct.file import from_bytes
from tests.clients.answered import document
from tests.clients.bridges.rsi_peer import RsiPeer
from tests.clients.bridges.running_bridge import LATER_DEG, add_arm, bridging, measure, off_mm, shared_arm, states
from tests.clients.bridges.strangers import strangers
from tests.clients.bridges.udp_peer import Floats
from tests.clients.cutting_proxy import CuttingProxy

CYCLE_S = 0.012
RATE_DEG_S = 2.0
PACE = ["--cycle-ms", "12", "--rate-deg-s", str(RATE_DEG_S), "--ramp-s", "0.5", "--gone-after-s", "2", "--port", "0"]
CALIBRATED_MM, NOMINAL_MM = 0.05, 0.5  # nowhere on the path is the arm less than 0.57 mm off without a correction
SETTLED = 40  # answered cycles in which an offset that is ramped in follows the path again
RAMP_OF_VERSIONS = 100  # answered cycles, which take 1.2 s at least: the ramp between versions takes a second


def path(t_s: float) -> Floats:
    """A slow motion of three axes; the others rest."""
    return np.array([30 * np.sin(0.4 * t_s), 30 + 20 * np.sin(0.5 * t_s), 20 + 30 * np.sin(0.3 * t_s), 0.0, 0.0, 0.0])


def jumps(peer: RsiPeer) -> Floats:
    """Fastest change of any offset between answers that came, deg/s by the cycles between them (N - 1,)."""
    answered = np.flatnonzero(peer.answered())
    offsets = peer.offsets()[answered]
    found: Floats = np.abs(np.diff(offsets, axis=0)).max(axis=1) / (np.diff(answered) * CYCLE_S)
    return found


@pytest.fixture
def arm(kilter: Kilter, tmp_path: Path) -> str:
    return shared_arm(kilter, tmp_path)


@pytest.fixture
def own_arm(kilter: Kilter, tmp_path: Path, request: pytest.FixtureRequest) -> str:
    name = re.sub(r"\W", "-", request.node.name)[:60]
    add_arm(kilter, name, tmp_path)
    return name


@contextmanager
def published(line: str) -> Iterator[zenoh.Subscriber[zenoh.handlers.FifoChannel]]:
    """What a bridge publishes, by what it says of it."""
    found = re.search(r"published on (\S+) as (\S+)\.$", line)
    assert found is not None
    with (
        zenoh.open(session_config(zenoh, [found[1]])) as session,
        session.declare_subscriber(found[2], zenoh.handlers.FifoChannel(10_000)) as subscriber,
    ):
        yield subscriber


def test_the_arm_is_on_its_path_ramped_in_and_out_through_a_change_of_version(
    own_arm: str, kilter: Kilter, tmp_path: Path
) -> None:
    with bridging("rsi", own_arm, *PACE) as bridge, published(bridge.heard("published on")) as subscriber:
        bridge.heard("waiting")
        while json.loads(subscriber.recv().payload.to_bytes())["state"] != "waiting":  # then the rest is surely heard
            pass
        peer = RsiPeer(bridge.port, path).start()
        try:
            bridge.heard("correcting")
            peer.wait_answered(SETTLED)
            until_change = len(peer.rows)
            version = measure(kilter, own_arm, LATER_DEG, tmp_path, "tuesday")
            bridge.heard(version)
            peer.wait_answered(RAMP_OF_VERSIONS + SETTLED)
            until_end = len(peer.rows)
            assert run(["robot", "compensation", own_arm, "factory"]) == 0
            bridge.heard("off.*corrected twice")
            peer.wait_answered(2)
            assert not peer.offset.any()
            assert run(["robot", "compensation", own_arm, "none"]) == 0
            peer.until(lambda one: bool(one.offset.any()))
            peer.wait_answered(SETTLED)
            assert peer.offset.any()
            told = states(subscriber)
            bridge.ended()
            peer.wait(2)
        finally:
            peer.stop()
    answered, wanted, offsets = peer.answered(), peer.wanted(), peer.offsets()
    settled = np.flatnonzero(answered[:until_change])[-SETTLED // 2 :]  # a busy machine makes others late
    assert off_mm(wanted, 0 * offsets)[settled].min() > NOMINAL_MM
    assert off_mm(wanted, offsets)[settled].max() < CALIBRATED_MM
    changed = np.flatnonzero(answered[:until_end])[-SETTLED // 2 :]
    assert off_mm(wanted, 0 * offsets, LATER_DEG)[changed].min() > NOMINAL_MM
    assert off_mm(wanted, offsets, LATER_DEG)[changed].max() < CALIBRATED_MM
    assert np.abs(offsets[np.flatnonzero(answered)[0]]).max() < RATE_DEG_S * CYCLE_S  # it begins at nothing
    assert jumps(peer).max() < RATE_DEG_S * 1.001 + 1e-3
    assert not offsets[-1].any()  # and ends at nothing
    assert not offsets[:, 3:].any()  # axes that the robot does not have
    assert {"ramping in", "correcting", "off"} <= {one["state"] for one in told}
    assert {one["robot"] for one in told} == {own_arm}
    assert told[-1]["version_id"] == version


def test_the_actual_joints_do_where_a_controller_sends_no_setpoints(arm: str) -> None:
    with bridging("rsi", arm, *PACE, "--joints-from", "AIPos") as bridge:
        bridge.heard("waiting")
        peer = RsiPeer(bridge.port, path, setpoints=False).start()
        try:
            peer.wait(120)
        finally:
            peer.stop()
        last = np.flatnonzero(peer.answered())[-20:]
        assert re.search(r"rsi bridge of .*: \d+ answers, late \d+", bridge.ended())
    assert off_mm(peer.wanted(), peer.offsets())[last].max() < CALIBRATED_MM


def test_a_killed_bridge_leaves_the_offsets_and_the_next_one_does_not_take_over(
    arm: str, server: Path, kilter: Kilter
) -> None:
    port = int(kilter.url.rpartition(":")[2])
    with CuttingProxy(port).running() as proxy, bridging("rsi", arm, *PACE, KILTER_URL=proxy.url) as bridge:
        bridge.heard("waiting")
        peer = RsiPeer(bridge.port, path).start()
        try:
            bridge.heard("correcting")
            peer.wait(60)
            proxy.cuts = lambda head, piece: "drop"
            bridge.heard("the server .*, and the version goes on")
            began = len(peer.rows)
            peer.wait(40)
            assert peer.answered()[began:].any()
            assert off_mm(peer.wanted(), peer.offsets())[-20:][peer.answered()[-20:]].max() < CALIBRATED_MM
            bridge.process.send_signal(signal.SIGKILL)
            bridge.process.wait()
            killed = len(peer.rows)
            peer.wait(40)
            assert not peer.answered()[killed + 2 :].any()
            assert (
                np.ptp(peer.offsets()[killed + 2 :], axis=0).max() == 0.0
            )  # it holds; a real controller stops by itself
            again = [one for one in PACE if one != "0"] + [str(bridge.port)]
            with bridging("rsi", arm, *again) as second:
                second.heard("refusing.*asked already")
                peer.wait(100)
                assert not peer.answered()[killed + 2 :].any()
                peer.stop()
                second.heard("waiting")
                fresh = RsiPeer(second.port, path, ipoc=peer.ipoc).start()
                try:
                    second.heard("correcting")
                finally:
                    fresh.stop()
                assert jumps(fresh).max() < RATE_DEG_S * 1.001 + 1e-3
        finally:
            peer.stop()
    assert jumps(peer).max() < RATE_DEG_S * 1.001 + 1e-3


REFUSED = {
    "unknown": ("compensation_unknown", "Check once whether"),
    "factory": ("corrected_twice", "maker's calibration"),
    "kilter": ("corrected_twice", "a calibration that Kilter exported"),
}


def test_a_controller_that_may_correct_already_is_refused_in_words(
    arm: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for compensation, (code, said) in REFUSED.items():
        assert run(["robot", "compensation", arm, compensation]) == 0
        problem = document(capsys, "bridge", "rsi", arm, code=1)
        assert problem["code"] == code
        assert said in problem["detail"]
        assert "--force" in problem["detail"]
    with bridging("rsi", arm, "--port", "0", "--force") as bridge:
        bridge.heard("starting")


def test_a_version_of_another_robot_is_refused_at_the_start(arm: str, own_arm: str, kilter: Kilter) -> None:
    foreign = kilter.robots.get(arm)["active_version"]
    with pytest.raises(NotFoundError, match=f"is of robot {arm}, not of {own_arm}: name one of") as refused:
        fetch_startup_version(own_arm, foreign, False)
    assert refused.value.code == "version_not_found"


def test_the_version_that_a_bridge_follows_is_the_active_one_or_that_it_was_told(
    own_arm: str, kilter: Kilter, tmp_path: Path
) -> None:
    old = kilter.versions.get(kilter.robots.get(own_arm)["active_version"])
    known = Followed(old["sha256"][:16])
    assert poll_server(own_arm, None, False, known) == (known, [], "")
    new = kilter.versions.get(measure(kilter, own_arm, LATER_DEG, tmp_path, "tuesday"))
    later, news, _ = poll_server(own_arm, None, False, known)
    assert later.number == new["sha256"][:16]
    assert [(kind, from_bytes(text).version_id) for kind, text in news] == [(Kind.PROGRAM, new["id"])]
    assert poll_server(own_arm, old["id"], False, known) == (known, [], "")  # told, it stays
    kilter.versions.retire(old["id"])
    with pytest.raises(ConflictError, match="is retired: restore it") as retired:
        fetch_startup_version(own_arm, old["id"], False)
    assert retired.value.code == "retired"
    off, news, _ = poll_server(own_arm, old["id"], False, known)
    assert news == [(Kind.OFF, f"version {old['id']} is retired".encode())]
    assert poll_server(own_arm, old["id"], False, off) == (off, [], "")  # it is said once
    kilter.versions.restore(old["id"])
    assert [kind for kind, _ in poll_server(own_arm, old["id"], False, off)[1]] == [Kind.PROGRAM]
    assert [kind for kind, _ in poll_server("nobody", None, False, known)[1]] == [Kind.OFF]


def test_what_cannot_be_bridged_is_refused_before_anything_listens(
    robot: str, arm: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["robot", "compensation", robot, "none"]) == 0
    assert run(["bridge", "rsi", robot]) == 1
    assert "has no active version: activate one" in capsys.readouterr().err
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        for options, said in (
            (["--signs", "+,-"], "each of the 3 joints"),
            (["--listen", "203.0.113.7", "--port", "0"], "Name an address of this machine in --listen"),
            (["--port", str(taken.getsockname()[1])], "end it, or name another --port"),
        ):
            assert run(["bridge", "rsi", arm, *options]) == 2
            assert said in capsys.readouterr().err


def test_a_bridge_that_any_machine_can_take_says_so_and_the_named_controller_is_followed(arm: str) -> None:
    with bridging("rsi", arm, *PACE, "--listen", "0.0.0.0") as bridge:
        assert "--controller ADDRESS" in bridge.heard("Warning: any machine")
    with bridging("rsi", arm, *PACE, "--listen", "0.0.0.0", "--controller", "127.0.0.1") as bridge:
        bridge.heard("waiting")
        assert not re.search("Warning", "".join(bridge.said))
        with strangers(bridge.port, 200, source="127.0.0.2"):
            peer = RsiPeer(bridge.port, path).start()
            try:
                bridge.heard("correcting")
                peer.wait_answered(2)
            finally:
                peer.stop()
        assert re.search(r"other_controller: \d+", bridge.ended())


@pytest.mark.parametrize("address", ["cell7", "192.168.1", "127.0.0.1:x", "127.0.0.1:70000", "", "::1"])
def test_a_controller_that_is_not_an_address_is_refused(
    arm: str, address: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["bridge", "rsi", arm, *PACE, "--controller", address]) == 2
    assert "192.168.1.20:50000" in capsys.readouterr().err
