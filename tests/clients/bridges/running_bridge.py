"""A bridge as a person starts it, in a process of its own, and the calibrated arm that it corrects."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np

from kilter_client import Kilter
from kilter_client.cli import run
from kilter_client.errors import NotFoundError
from tests.clients.bridges.udp_peer import GUARD_S
from tests.clients.three_joint_arm import LENGTHS_MM, Floats, tip_mm
from tests.clients.three_joint_arm import arm as three_joint_arm
from tests.service.forked import KILTER, ForkedPopen

REAL_MM = (400.0, 300.6, 199.5)
PRIORITY = os.environ.get("PRIORITY")  # real-time, of a bridge and of what plays its robot
REAL_TIME = ["chrt", "--fifo", PRIORITY] if PRIORITY else []
OFF_DEG = np.array([0.1, -0.05, 0.08])
LATER_DEG = np.array([0.25, -0.05, 0.2])  # after something slipped


def measure(kilter: Kilter, name: str, off_deg: Floats, folder: Path, campaign: str) -> str:
    """Identify and activate what exact measurements of the arm with these offsets say; the version's id."""
    rng = np.random.default_rng(3)
    q = rng.uniform((-90, 0, -80), (90, 70, 80), (60, 3))
    seen = tip_mm(q + off_deg, REAL_MM) + rng.normal(0, 1e-4, q.shape)
    path = folder / f"{campaign}.csv"
    lines = [",".join(f"{v:.9g}" for v in row) for row in np.hstack([q, seen])]
    path.write_text("\n".join(["q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm", *lines, ""]))
    assert run(["upload", name, str(path), "--name", campaign]) == 0
    fit = ["identify", name, "-c", campaign, "--level", "2", "--tool", "fixed", "--base", "fixed"]
    assert run(fit) == 0
    assert run(["activate", "latest", "--robot", name, "--force"]) == 0
    return str(kilter.robots.get(name)["active_version"])


def add_arm(kilter: Kilter, name: str, folder: Path, compensation: str = "none") -> str:
    """Add the arm, calibrated, with a controller that corrects so; its active version."""
    kilter.robots.add({**three_joint_arm(name), "controller_compensation": compensation})
    return measure(kilter, name, OFF_DEG, folder, "monday")


def shared_arm(kilter: Kilter, folder: Path) -> str:
    """The calibrated arm of all tests that make no version of it, and whose controller does not correct."""
    name = "bridged"
    try:
        kilter.robots.get(name)
    except NotFoundError:
        add_arm(kilter, name, folder)
    kilter.robots.compensation(name, "none")
    return name


def off_mm(wanted_deg: Floats, offset_deg: Floats, off_deg: Floats = OFF_DEG) -> Floats:
    """How far the real arm's tool is from where a nominal arm would have it (N,)."""
    there = tip_mm(wanted_deg[:, :3] + offset_deg[:, :3] + off_deg, REAL_MM)
    distance: Floats = np.linalg.norm(there - tip_mm(wanted_deg[:, :3], LENGTHS_MM), axis=1)
    return distance


class Bridge:
    """A running bridge: its port, what it says, and what it says at its end."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process, self.port = process, 0
        self.said: list[str] = []
        assert process.stderr is not None
        self._reader = Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.said.append(line.rstrip())

    def hear_the_end(self) -> None:
        """Wait until nothing it said is left to be read."""
        self._reader.join()

    def heard(self, pattern: str, seconds: float = GUARD_S) -> str:
        """Wait until it says something."""
        end = time.monotonic() + seconds
        while True:
            for line in list(self.said):
                if re.search(pattern, line):
                    found = re.search(r"UDP \S+?:(\d+)", line)
                    self.port = int(found[1]) if found else self.port
                    return line
            assert time.monotonic() < end, self.said
            assert self.process.poll() is None or self._reader.is_alive(), self.said
            time.sleep(0.02)

    def ended(self, number: int = signal.SIGTERM) -> str:
        """End it by a signal; what it prints then."""
        self.process.send_signal(number)
        assert self.process.stdout is not None
        out = self.process.stdout.read()
        assert self.process.wait(GUARD_S) == 0, self.said
        return out


@contextmanager
def bridging(*arguments: str, **environment: str) -> Iterator[Bridge]:
    """Run ``kilter bridge`` with these arguments."""
    start = (
        subprocess.Popen if REAL_TIME or "PYTHONPATH" in environment else ForkedPopen
    )  # a fork imports what it knows
    process = start(
        [*REAL_TIME, *KILTER, "bridge", *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ, **environment},
    )  # fmt: skip
    bridge = Bridge(process)
    try:
        bridge.heard(r"listens on UDP|published")
        yield bridge
    finally:
        process.kill()
        process.wait()
        bridge.hear_the_end()
        for pipe in (process.stdout, process.stderr):
            assert pipe is not None
            pipe.close()


def states(subscriber: Any) -> list[dict[str, Any]]:
    """What a bridge has published since it was looked at last."""
    found = []
    while (sample := subscriber.try_recv()) is not None:
        found.append(json.loads(sample.payload.to_bytes()))
    return found
