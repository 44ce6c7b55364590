"""Cycles that each bridge answers late with packets of strangers, and with as many sent elsewhere, in turns.

Bridge, controller and strangers are processes of one machine: what the strangers cost it is the same in both.
"""

from __future__ import annotations

import argparse
import os
import re
import socket
import sys
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager, redirect_stdout
from pathlib import Path

import numpy as np

from kilter_client import Kilter
from kilter_client.requests.connection import local_server
from tests.clients.bridges import test_fci_bridge as fci
from tests.clients.bridges.egm_peer import EgmPeer
from tests.clients.bridges.franka_arm import table
from tests.clients.bridges.rsi_peer import RsiPeer
from tests.clients.bridges.running_bridge import PRIORITY, Bridge, add_arm, bridging
from tests.clients.bridges.strangers import strangers
from tests.clients.bridges.udp_peer import Floats, UdpPeer

Noise = Callable[[int], AbstractContextManager[None]]


def path(t_s: float) -> Floats:
    """A motion of three axes at up to 12 deg/s, with the elbow bent."""
    return np.array([30 * np.sin(0.4 * t_s), 30 + 20 * np.sin(0.5 * t_s), 50 + 30 * np.sin(0.3 * t_s), 0.0, 0.0, 0.0])


def asked(kind: str, folder: Path, cycles: int, noise: Noise) -> tuple[int, int, str]:
    """Ask a bridge every 4 ms; returns the late of so many cycles by the controller's count, and what the bridge counted."""
    rows = [",".join(f"{value:.9f}" for value in (t, *path(t)[:3])) for t in np.arange(0.0, 0.005 * cycles + 60.0, 0.1)]
    (folder / "path.csv").write_text("\n".join(["t_s,q1_deg,q2_deg,q3_deg", *rows, ""]))
    plays = ["--path", str(folder / "path.csv")] if kind == "egm" else []
    with bridging(kind, "cell7", "--port", "0", "--cycle-ms", "4", *plays) as bridge:
        bridge.heard("waiting")
        peer: UdpPeer = (
            RsiPeer(bridge.port, path, cycle_s=0.004)
            if kind == "rsi"
            else EgmPeer(bridge.port, path(0.0)[:3], running=True, cycle_s=0.004)
        )
        peer.start()
        with noise(bridge.port):
            peer.wait(cycles, seconds=1e9)
        peer.stop()
        said = bridge.ended()
    answered = peer.answered()
    return int((~answered).sum()), len(answered), said


def played(folder: Path, cycles: int, noise: Noise) -> tuple[int, int, str]:
    """Let a simulated Franka robot play a table at 1 kHz; returns the late and lost commands by the bridge's count."""
    with fci.simulator(folder), fci.moving("fr3", table(cycles / 1000.0, fci.REST_S), folder) as bridge:
        bridge.heard("correct")
        with noise(_state_port(bridge)):
            assert bridge.process.stdout is not None
            said = bridge.process.stdout.read()
    if bridge.process.returncode:
        raise RuntimeError("\n".join(bridge.said))
    counts = {name: int(number) for name, number in re.findall(r"(late|lost):? (\d+)", said)}
    answers = re.search(r"(\d+) answers", said)
    return sum(counts.values()), int(answers[1]) if answers else 0, said


def _state_port(bridge: Bridge) -> int:
    """The UDP port at which the robot's library hears the robot."""
    own = {os.readlink(one) for one in Path(f"/proc/{bridge.process.pid}/fd").iterdir() if one.is_symlink()}
    lines = Path(f"/proc/{bridge.process.pid}/net/udp").read_text().splitlines()[1:]
    return next(int(line.split()[1].split(":")[1], 16) for line in lines if f"socket:[{line.split()[9]}]" in own)


def main() -> None:
    """Measure the bridges in turns and print a line of each round."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", default="rsi,egm,fci" if fci.ENVIRONMENT.exists() else "rsi,egm")
    parser.add_argument("--cycles", type=int, default=5000)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--per-second", type=int, default=2000)
    given = parser.parse_args()
    if PRIORITY:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(int(PRIORITY)))
    with tempfile.TemporaryDirectory() as folder, local_server(Path(folder) / "data") as server:
        os.environ.update(server.environment())
        with Kilter() as kilter, redirect_stdout(sys.stderr):
            add_arm(kilter, "cell7", Path(folder))
            if "fci" in given.kinds:
                fci.calibrated(kilter, "fr3", Path(folder))
        elsewhere = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        elsewhere.bind(("127.0.0.1", 0))
        for number, kind in ((n, k) for k in given.kinds.split(",") for n in range(2 * given.rounds)):
            spared = elsewhere.getsockname()[1] if number % 2 == 0 else None

            def noise(port: int, spared: int | None = spared) -> AbstractContextManager[None]:
                return strangers(spared or port, given.per_second, source="127.0.0.2")

            place = Path(tempfile.mkdtemp(dir=folder))
            late, count, said = (
                played(place, given.cycles, noise) if kind == "fci" else asked(kind, place, given.cycles, noise)
            )
            if not count:
                raise RuntimeError(f"The {kind} bridge answered nothing: {said}")
            dropped = re.search(r"other_controller: (\d+)", said)
            where, load = "elsewhere" if spared else "to it", os.getloadavg()[0]
            print(f"{kind}, {given.per_second} packets a second {where}: {late} of {count} late,", end=" ")
            print(f"{dropped[1] if dropped else 0} dropped by the bridge, load {load:.1f}", flush=True)


if __name__ == "__main__":
    main()
