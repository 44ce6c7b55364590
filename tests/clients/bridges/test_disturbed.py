"""Bridges as processes whose network loses packets, and whose controllers send what they should not."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from kilter_client import Kilter
from tests.clients.bridges.egm_peer import EgmPeer
from tests.clients.bridges.rsi_peer import RsiPeer
from tests.clients.bridges.running_bridge import bridging, off_mm, shared_arm
from tests.clients.bridges.udp_peer import Floats

CYCLE_S, RATE_DEG_S, SPEED_DEG_S = 0.012, 2.0, 4.0
PACE = [
    "--cycle-ms", "12", "--rate-deg-s", str(RATE_DEG_S), "--ramp-s", "0.5", "--gone-after-s", "4", "--port", "0",
]  # fmt: skip
CALIBRATED_MM = 0.05
BEGIN = np.array([0.0, 30.0, 20.0])
LOSSES = (1, 10, 100)
FAR_S = 0.1  # of motion at the highest speed: so far behind the arm may be before the plan waits for it
SETTLED = 20  # answered cycles in which offsets come back after a loss


def path(t_s: float) -> Floats:
    """A slow motion of three axes; the others rest."""
    return np.array([30 * np.sin(0.4 * t_s), 30 + 20 * np.sin(0.5 * t_s), 20 + 30 * np.sin(0.3 * t_s), 0.0, 0.0, 0.0])


@dataclass
class Network:
    """What becomes of the packets of the next cycles: so many requests are lost, then so many answers."""

    requests: int = 0
    answers: int = 0

    def takes(self, send: Callable[[], object]) -> bool:
        """Whether it loses one packet of this cycle; the request is sent where it loses the answer."""
        if self.requests:
            self.requests -= 1
        elif self.answers:
            self.answers -= 1
            send()
        else:
            return False
        return True

    @property
    def lossless(self) -> bool:
        """Whether nothing more is lost."""
        return not self.requests and not self.answers


@dataclass
class CutRsi(RsiPeer):
    """Beside a network that loses; ``other`` messages are sent in place of the next ones, and their answers not looked for."""

    network: Network = field(default_factory=Network)
    other: list[Callable[[RsiPeer, Floats], bytes]] = field(default_factory=list)

    def _cycle(self, cycle: int) -> tuple[bool, Floats, Floats]:
        wanted = self.path(cycle * self.cycle_s)
        lost = self.network.takes(lambda: self._socket.send(self.message(wanted)))
        if not lost and not self.other:
            return super()._cycle(cycle)
        if self.other:
            self._exchange(self.other.pop(0)(self, wanted))
        self.late += 1
        self.ipoc += round(1000 * self.cycle_s)
        return False, wanted, self.offset.copy()


@dataclass
class CutEgm(EgmPeer):
    """The same of the other controller; ``other`` joints, or another number, are sent in place of where the arm stands."""

    network: Network = field(default_factory=Network)
    other: list[Mapping[str, object]] = field(default_factory=list)

    def _cycle(self, cycle: int) -> tuple[bool, bool, Floats]:
        if self.network.takes(lambda: self._socket.send(self.message())):
            self.sequence += 1
            return False, self.running, self.joints.copy()
        if not self.other:
            return super()._cycle(cycle)
        there, number, said = self.joints, self.sequence, self.other.pop(0)
        self.joints = np.array(said.get("joints", there))
        self.sequence = number + int(str(said.get("later", 0)))
        self._socket.send(self.message())
        self.joints, self.sequence = there, number + 1
        return False, self.running, self.joints.copy()


@pytest.fixture
def arm(kilter: Kilter, tmp_path: Path) -> str:
    return shared_arm(kilter, tmp_path)


def settled_mm(peer: RsiPeer) -> float:
    """How far the real tool is off in the last answered cycles."""
    last = np.flatnonzero(peer.answered())[-5:]
    return float(off_mm(peer.wanted(), peer.offsets())[last].max())


def count(out: str, name: str) -> int:
    found = re.search(rf"\b{name}:? (\d+)", out)
    return int(found[1]) if found else 0


def test_offsets_go_on_where_the_network_loses_requests_or_answers(arm: str) -> None:
    with bridging("rsi", arm, *PACE) as bridge:
        bridge.heard("waiting")
        peer = CutRsi(bridge.port, path).start()
        try:
            bridge.heard("correcting")
            peer.wait_answered(SETTLED)
            assert settled_mm(peer) < CALIBRATED_MM
            for lost in LOSSES:
                for network in (Network(requests=lost), Network(answers=lost)):
                    peer.network = network
                    peer.until(lambda one: one.network.lossless)
                    before = len(peer.rows)
                    peer.wait_answered(SETTLED + lost)
                    assert peer.answered()[before:].any()
                    assert settled_mm(peer) < CALIBRATED_MM, (lost, network)
            out = bridge.ended()
        finally:
            peer.stop()
    steps = np.abs(np.diff(peer.offsets(), axis=0)).max()
    assert steps < RATE_DEG_S * CYCLE_S * 1.001 + 1e-5
    # Requests that a busy machine let wait beside one that was lost are late.
    assert count(out, "lost") + count(out, "late") >= sum(LOSSES) - len(LOSSES)


def rsi_with(axes: Callable[[Floats], Floats | list[object]], ahead: int = 0) -> Callable[[RsiPeer, Floats], bytes]:
    """A message with other axes, or another IPOC."""

    def message(peer: RsiPeer, wanted: Floats) -> bytes:
        named = " ".join(f'A{k}="{value}"' for k, value in enumerate(axes(wanted), 1))
        return f'<Rob TYPE="KUKA"><ASPos {named}/><IPOC>{peer.ipoc + ahead}</IPOC></Rob>'.encode()

    return message


WRONG_RSI = {
    "BAD_FRAME": [rsi_with(lambda q: q[:2]), rsi_with(lambda q: ["x", *q[1:]]), rsi_with(lambda q: [])],
    "NOT_FINITE": [rsi_with(lambda q: [math.nan, *q[1:]]), rsi_with(lambda q: ["1e999", *q[1:]])],
    "JOINT_LIMIT": [rsi_with(lambda q: [400.0, *q[1:]])],
    "malformed": [lambda peer, q: b"\0" * 900, lambda peer, q: b"<Rob>", lambda peer, q: peer.message(q)[:-9]],
    "old_stamp": [rsi_with(lambda q: q, -24), rsi_with(lambda q: q, -36)],
}


def test_what_a_controller_should_not_send_is_counted_and_moves_no_offset_by_more_than_its_rate(arm: str) -> None:
    with bridging("rsi", arm, *PACE) as bridge:
        bridge.heard("waiting")
        peer = CutRsi(bridge.port, path).start()
        second = RsiPeer(bridge.port, path)
        try:
            bridge.heard("correcting")
            for wrong in WRONG_RSI.values():
                peer.other = [*wrong]
                peer.until(lambda one: not one.other)
                peer.wait_answered(SETTLED)
                assert settled_mm(peer) < CALIBRATED_MM
            second.start()
            second.wait(30)
            peer.wait_answered(SETTLED)
            assert settled_mm(peer) < CALIBRATED_MM
            assert not second.answered().any()
            out = bridge.ended()
        finally:
            second.stop()
            peer.stop()
    assert np.abs(np.diff(peer.offsets(), axis=0)).max() < RATE_DEG_S * CYCLE_S * 1.001 + 1e-5
    told = {name: count(out, name) for name in WRONG_RSI}
    assert all(told[name] >= len(wrong) for name, wrong in WRONG_RSI.items()), out
    assert count(out, "other_controller") >= 20


def slow(t_s: Floats) -> Floats:
    """To and fro between two places (N, 3) deg, from rest."""
    part = 0.5 * (1.0 - np.cos(2.0 * np.pi * t_s / 40.0))
    return BEGIN + part[:, None] * np.array([30.0, 15.0, -15.0])


@pytest.fixture
def table(tmp_path: Path) -> Path:
    t_s = np.arange(0.0, 320.0, 0.1)
    np.savetxt(
        tmp_path / "table.csv", np.column_stack([t_s, slow(t_s)]), "%.9f", ",", header="t_s,q1_deg,q2_deg,q3_deg",
        comments="",
    )  # fmt: skip
    return tmp_path / "table.csv"


def from_path_mm(joints: Floats) -> float:
    """How far the real tool is from the nearest point of the path, for a command (3,) deg."""
    way = BEGIN + np.linspace(0.0, 1.0, 30_001)[:, None] * np.array([30.0, 15.0, -15.0])
    return float(off_mm(way, joints - way).min())


WRONG_EGM: list[Mapping[str, object]] = [
    {"joints": [math.nan, 30.0, 20.0]}, {"joints": [0.0, 30.0]}, {"joints": [0.0] * 6}, {"joints": []}, {"later": -30},
]  # fmt: skip


def test_an_arm_that_is_led_goes_on_where_packets_are_lost_or_wrong(arm: str, table: Path) -> None:
    options = ["--speed-deg-s", str(SPEED_DEG_S), "--path", str(table)]
    with bridging("egm", arm, *PACE, *options) as bridge:
        bridge.heard("waiting")
        peer = CutEgm(bridge.port, BEGIN, running=True).start()
        second = EgmPeer(bridge.port, BEGIN + 1.0, running=True)
        try:
            bridge.heard("correcting")
            for lost in LOSSES:
                for network in (Network(requests=lost), Network(answers=lost)):
                    peer.network = network
                    peer.until(lambda one: one.network.lossless)
                    peer.wait_answered(SETTLED)
                    assert from_path_mm(peer.positions()[-1]) < CALIBRATED_MM, (lost, network)
            peer.other = [*WRONG_EGM, WRONG_EGM[-1]]  # one that comes with the next packet is passed over
            peer.until(lambda one: not one.other)
            peer.wait_answered(SETTLED)
            second.start()
            second.wait(30)
            peer.wait_answered(SETTLED)
            assert from_path_mm(peer.positions()[-1]) < CALIBRATED_MM
            assert not second.answered().any()
            out = bridge.ended()
        finally:
            second.stop()
            peer.stop()
    answered = np.flatnonzero(peer.answered())
    steps = np.abs(np.diff(peer.positions(), axis=0)).max()
    assert len(answered) > 50
    assert steps < SPEED_DEG_S * FAR_S + (SPEED_DEG_S + RATE_DEG_S) * CYCLE_S * 1.001
    assert count(out, "arm_behind") > 0
    assert count(out, "joints_unusable") >= 4
    assert count(out, "old_stamp") >= 1
    assert count(out, "other_controller") >= 20
