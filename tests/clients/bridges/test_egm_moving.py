"""`kilter bridge egm` under a moving arm: another version, a controller that corrects itself, and the bridge killed."""

from __future__ import annotations

import re
import signal
from pathlib import Path

import numpy as np
import pytest

from kilter_client import Kilter
from kilter_client.cli import run
from tests.clients.answered import document
from tests.clients.bridges.egm_peer import EgmPeer
from tests.clients.bridges.running_bridge import LATER_DEG, add_arm, bridging, measure, off_mm
from tests.clients.three_joint_arm import Floats

CYCLE_S, SPEED_DEG_S, RATE_DEG_S = 0.012, 10.0, 2.0
BEGIN, END = np.array([0.0, 30.0, 20.0]), np.array([30.0, 45.0, 5.0])
TURNS_S = 40.0
PACE = [
    "--cycle-ms", "12", "--rate-deg-s", str(RATE_DEG_S), "--speed-deg-s", str(SPEED_DEG_S), "--ramp-s", "0.5",
    "--gone-after-s", "2",
]  # fmt: skip
CALIBRATED_MM = 0.05


def path(t_s: Floats) -> Floats:
    """To and fro between two places (N, 3) deg, from rest."""
    part = 0.5 * (1.0 - np.cos(2.0 * np.pi * t_s / TURNS_S))
    return BEGIN + part[:, None] * (END - BEGIN)


@pytest.fixture
def table(tmp_path: Path) -> Path:
    t_s = np.arange(0.0, 8 * TURNS_S, 0.1)
    rows = np.column_stack([t_s, path(t_s)])
    head = "t_s,q1_deg,q2_deg,q3_deg"
    np.savetxt(tmp_path / "table.csv", rows, "%.9f", ",", header=head, comments="")
    return tmp_path / "table.csv"


@pytest.fixture
def own_arm(kilter: Kilter, tmp_path: Path, request: pytest.FixtureRequest) -> str:
    name = re.sub(r"\W", "-", request.node.name)[:60]
    add_arm(kilter, name, tmp_path)
    return name


def fastest(peer: EgmPeer) -> float:
    """The fastest motion of any joint between answers that came, deg/s by the cycles between them."""
    answered = np.flatnonzero(peer.answered())
    steps = np.abs(np.diff(peer.positions()[answered], axis=0)).max(axis=1)
    return float((steps / (np.diff(answered) * CYCLE_S)).max())


def from_path_mm(joints: Floats, off_deg: Floats) -> Floats:
    """How far the real tool is from the nearest point of the path, for commands (N, 3) deg."""
    way = BEGIN + np.linspace(0.0, 1.0, 30_001)[:, None] * (END - BEGIN)  # a point each 0.001 deg of the first joint
    return np.array([off_mm(way, one - way, off_deg).min() for one in joints])


def test_another_version_and_a_controller_that_corrects_itself_are_taken_up_under_way(
    own_arm: str, table: Path, kilter: Kilter, tmp_path: Path
) -> None:
    with bridging("egm", own_arm, *PACE, "--port", "0", "--path", str(table)) as bridge:
        bridge.heard("waiting")
        peer = EgmPeer(bridge.port, BEGIN, running=True).start()
        try:
            bridge.heard("correcting")
            peer.wait(100)
            first = peer.positions()[-10:]
            version = measure(kilter, own_arm, LATER_DEG, tmp_path, "tuesday")
            bridge.heard(version)
            peer.wait(200)
            second = peer.positions()[-10:]
            assert run(["robot", "compensation", own_arm, "factory"]) == 0
            bridge.heard("off.*corrected twice")
            peer.wait(100)
            without = peer.positions()[-10:]
            peer.wait(2)
            bridge.ended()
        finally:
            peer.stop()
    assert peer.answered().sum() > 0.3 * len(peer.rows)  # a busy machine makes some late
    assert from_path_mm(first, np.array([0.1, -0.05, 0.08])).max() < CALIBRATED_MM
    assert from_path_mm(second, LATER_DEG).max() < CALIBRATED_MM
    assert from_path_mm(without, np.zeros(3)).max() < 1.0  # as a nominal arm
    assert from_path_mm(without, LATER_DEG).max() > CALIBRATED_MM
    assert np.ptp(peer.positions(), axis=0).max() > 2.0
    assert fastest(peer) < (SPEED_DEG_S + RATE_DEG_S) * 1.001


def test_a_killed_bridge_leaves_the_arm_where_it_is_and_the_next_one_waits_for_silence(
    own_arm: str, table: Path
) -> None:
    with bridging("egm", own_arm, *PACE, "--port", "0", "--path", str(table)) as bridge:
        bridge.heard("waiting")
        peer = EgmPeer(bridge.port, BEGIN, running=True).start()
        try:
            bridge.heard("correcting")
            peer.wait(60)
            bridge.process.send_signal(signal.SIGKILL)
            bridge.process.wait()
            killed = len(peer.rows)
            peer.wait(40)
            assert not peer.answered()[killed + 2 :].any()
            with bridging("egm", own_arm, *PACE, "--port", str(bridge.port), "--path", str(table)) as second:
                second.heard("refusing.*asked already")
                peer.wait(60)
                assert not peer.answered()[killed + 2 :].any()  # the controller ends EGM by itself
                assert np.ptp(peer.positions()[killed + 2 :], axis=0).max() == 0.0
                peer.stop()
                second.heard("waiting")
                again = EgmPeer(second.port, BEGIN, running=True).start()
                try:
                    second.heard("correcting")
                    again.wait(60)
                finally:
                    again.stop()
                assert np.abs(again.positions()[0] - BEGIN).max() < (SPEED_DEG_S + RATE_DEG_S) * CYCLE_S
                assert fastest(again) < (SPEED_DEG_S + RATE_DEG_S) * 1.001
        finally:
            peer.stop()
    assert fastest(peer) < (SPEED_DEG_S + RATE_DEG_S) * 1.001


@pytest.mark.parametrize("bridge", ["egm", "fci"])
def test_a_controller_that_may_correct_already_is_refused(
    own_arm: str, table: Path, bridge: str, kilter: Kilter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["bridge", bridge, own_arm, *(["127.0.0.1"] if bridge == "fci" else []), "--path", table]
    said = {"unknown": "compensation_unknown", "factory": "corrected_twice", "kilter": "corrected_twice"}
    for compensation, code in said.items():
        assert run(["robot", "compensation", own_arm, compensation]) == 0
        problem = document(capsys, *command, code=1)
        assert problem["code"] == code
        assert "--force" in problem["detail"]
    assert run(["robot", "compensation", own_arm, "none"]) == 0
    old = str(kilter.robots.get(own_arm)["active_version"])
    measure(kilter, own_arm, LATER_DEG, tmp_path, "tuesday")
    kilter.versions.retire(old)
    capsys.readouterr()
    problem = document(capsys, *command, "--version", old, code=1)
    assert problem["code"] == "retired"
    assert "is retired: restore it, or name another" in problem["detail"]
    other = f"{own_arm[:40]}-other"
    foreign = add_arm(kilter, other, tmp_path)
    capsys.readouterr()
    problem = document(capsys, *command, "--version", foreign, code=1)
    assert problem["code"] == "version_not_found"
    assert f"is of robot {other}, not of {own_arm}" in problem["detail"]
