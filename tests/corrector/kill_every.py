"""Kills every process of a server in turn under a controller at 1 kHz, and measures for how long the arm goes uncorrected.

``tools.lab kills-stream`` makes 200 kills. Killed is whatever runs: the supervisor too, which is started again at once, as the
system's service manager does.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import signal
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import httpx

from kilter_core.model import Calibration
from kilter_service.ground.settings import Settings
from tests.corrector.conftest import calibration_of
from tests.corrector.live import ROBOT, Q, until
from tests.corrector.stored import descendants, store_active

REPOSITORY = Path(__file__).resolve().parents[2]
LEAST_PAUSE_S = 0.001  # as both sides count it
RATE_DEG_S = 5.0  # what a version states at most
PATIENCE_S = 120.0
STEADY = 50  # looks, 10 ms apart
RECORD = struct.Struct("<qqb5d")  # monotonic ns before and after, how it was corrected, correction of each joint
ORDER = ("corrector", "stream", "supervisor", "nursery", "spare", "query", "api", "worker", "tracker", "helper")
SOURCES = ("corrected", "slowed", "held", "bypass")
CONTROLLER = """
import math, os, signal, struct, sys, time
from pathlib import Path
from kilter_client.stream import corrected
record, sources, rows = struct.Struct("<qqb5d"), ("corrected", "slowed", "held", "bypass"), []
going, began = True, 0
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(30))  # as a controller runs, where the system allows it
except OSError:
    pass
def stop(*_):
    global going
    going = False
signal.signal(signal.SIGTERM, stop)
def path():
    global began
    begin = time.monotonic()
    while going:
        t, began = time.monotonic() - begin, time.monotonic_ns()
        yield [q + 0.05 * math.sin(0.5 * t + k) for k, q in enumerate(map(float, sys.argv[5:]))]
period_s, deadline_s = map(float, sys.argv[3:5])
state = os.open(Path(sys.argv[2]) / "controller", os.O_RDWR | os.O_CREAT)
options = {"data": Path(sys.argv[2]), "deadline_s": deadline_s, "settled": True, "connect_timeout_s": 60.0}
for q in corrected(path(), sys.argv[1], period_s=period_s, **options):
    if not rows:
        print("corrected", flush=True)
    rows.append(record.pack(began, time.monotonic_ns(), sources.index(q.source), *q.delta))
    os.pwrite(state, q.source[:1].encode(), 0)
sys.stdout.buffer.write(b"".join(rows))
"""


class Pace(NamedTuple):
    """How often a controller sends, and for how long it waits."""

    period_s: float = 0.001
    deadline_s: float = 0.0008


class Row(NamedTuple):
    """A setpoint of the controller."""

    began_ns: int
    at_ns: int
    source: str
    delta: tuple[float, ...]


class Kill(NamedTuple):
    """A kill, and what it cost."""

    victim: str
    bypass_s: float  # the longest without an answer
    held_s: float
    all_s: float  # of bypass until the next kill: on a busy machine also answers that came late


class Done(NamedTuple):
    """What the kills cost, the largest change of a correction in a cycle (1: what is allowed), and how it ended."""

    kills: list[Kill]
    largest_step: float
    last: str


class Server:
    """`kilterd serve` with one robot and its active version; the same ports each time."""

    def __init__(self, folder: Path, calibration: Calibration) -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        self.settings = Settings(data=folder, database_url=None, port=port, zenoh_listen="tcp/127.0.0.1:0", token=None)
        store_active(self.settings, calibration)
        self._log = (folder.parent / "server.log").open("ab")
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it without waiting."""
        self.process = subprocess.Popen(
            [sys.executable, "-m", "kilter_service", "serve"],
            env={**os.environ, **self.settings.environment()},
            cwd=REPOSITORY, stdin=subprocess.DEVNULL, stdout=self._log, stderr=self._log,
        )  # fmt: skip

    def named(self) -> dict[str, int]:
        """Processes by what they do; empty while not all are there."""
        assert self.process is not None
        found = {"supervisor": self.process.pid}
        for pid in descendants(self.process.pid) | self._of_corrector().keys():
            with suppress(OSError):
                words = Path(f"/proc/{pid}/cmdline").read_bytes().decode().split("\0")
                if words != [""]:  # killed, and not yet buried
                    found[self._of_corrector().get(pid) or _name(words)] = pid
        needed = {"supervisor", "api", "worker", "corrector", "nursery", "spare", "stream", "query"}
        return found if needed <= found.keys() else {}

    def _of_corrector(self) -> dict[int, str]:
        with suppress(OSError, ValueError, KeyError):
            said = json.loads(self.settings.corrector_file.read_text(encoding="utf-8"))["processes"]
            return {pid: name for name, pid in said.items() if Path(f"/proc/{pid}").exists()}
        return {}

    def until_ready(self, unlike: int | None = None) -> dict[str, int]:
        """Wait until all processes stand, none of them this one, and the API answers that all is ready."""
        end = time.monotonic() + PATIENCE_S
        while True:
            named = self.named()
            if named and unlike not in named.values() and self._ready():
                return named
            assert self.process is not None
            assert self.process.poll() is None, "the server ended: see server.log"
            assert time.monotonic() < end, f"not all is back: {named}; see server.log"
            time.sleep(0.05)

    def _ready(self) -> bool:
        with suppress(httpx.TransportError):
            return httpx.get(f"http://127.0.0.1:{self.settings.port}/v1/health/ready", timeout=5).status_code == 200
        return False

    def kill(self, name: str, pid: int) -> int:
        """Kill a process; returns when, monotonic ns."""
        at_ns = time.monotonic_ns()
        os.kill(pid, signal.SIGKILL)
        if name == "supervisor" and self.process is not None:
            self.process.wait()
            self.start()
        return at_ns

    def stop(self) -> None:
        """End it."""
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(30)
            self.process.kill()
            self.process.wait()
        self._log.close()


def _name(words: list[str]) -> str:
    if "kilter_service" in words:
        return words[words.index("kilter_service") + 1]
    return "tracker" if any("resource_tracker" in word for word in words) else "helper"


@contextmanager
def controller(settings: Settings, pace: Pace) -> Iterator[Callable[[], list[Row]]]:
    """A controller in a process of its own, from its first corrected setpoint on; yields how to end it."""
    with subprocess.Popen(
        [sys.executable, "-c", CONTROLLER, ROBOT, str(settings.data), *map(str, (*pace, *Q))],
        cwd=REPOSITORY, stdout=subprocess.PIPE,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stdout.readline() == b"corrected\n"

        def end() -> list[Row]:
            process.terminate()
            data = process.stdout.read() if process.stdout is not None else b""
            return [Row(began, at, SOURCES[how], tuple(delta)) for began, at, how, *delta in RECORD.iter_unpack(data)]

        try:
            yield end
        finally:
            process.kill()


def campaign(folder: Path, kills: int, told: Callable[[str], Any], pace: Pace | None = None) -> Done:
    """Kill so many times; one process of each name before any of them again."""
    server = Server(folder / "data", calibration_of(ROBOT))
    killed: list[tuple[str, int]] = []
    try:
        server.start()
        named = server.until_ready()
        with controller(server.settings, pace or Pace()) as end:
            while len(killed) < kills:
                time.sleep(1.0)
                times = {name: sum(name == one for one, _ in killed) for name in named}
                victim = min((name for name in ORDER if name in named), key=lambda name: times[name])
                killed.append((victim, server.kill(victim, named[victim])))
                named = server.until_ready(unlike=named[victim])
                until(lambda: _is_corrected(server.settings), PATIENCE_S)  # what comes later is not this kill's
                told(f"{len(killed)}: {victim}, all is back after {(time.monotonic_ns() - killed[-1][1]) * 1e-9:.1f} s")
            time.sleep(1.0)
            rows = end()
    finally:
        server.stop()
    return Done(_costs(killed, rows), _largest_step(rows), rows[-1].source)


def _is_corrected(settings: Settings) -> bool:
    """Whether the controller's setpoints are corrected for some time on."""
    file = settings.data / "controller"
    for _ in range(STEADY):
        if file.read_bytes() != b"c":
            return False
        time.sleep(0.01)
    return True


def _costs(killed: list[tuple[str, int]], rows: list[Row]) -> list[Kill]:
    found = []
    ends = [at_ns for _, at_ns in killed[1:]] + [rows[-1].at_ns]
    for (victim, begin), end in zip(killed, ends, strict=True):
        here = [row for row in rows if begin <= row.at_ns < end]
        runs = [(source, list(run)) for source, run in itertools.groupby(here, lambda row: row.source)]
        spent = {
            source: [(run[-1].at_ns - run[0].began_ns) * 1e-9 for its, run in runs if its == source] or [0.0]
            for source in ("bypass", "held")
        }
        found.append(Kill(victim, max(spent["bypass"]), max(spent["held"]), sum(spent["bypass"])))
    return found


def _largest_step(rows: list[Row]) -> float:
    """Largest change of a joint's correction from one setpoint to the next, of what its stated rate allows."""
    largest = 0.0
    for before, row in itertools.pairwise(rows):
        allowed = math.radians(RATE_DEG_S) * max((row.at_ns - before.began_ns) * 1e-9, LEAST_PAUSE_S)
        largest = max(largest, max(abs(a - b) for a, b in zip(row.delta, before.delta, strict=True)) / allowed)
    return largest


def main() -> None:
    """Run a campaign and print its figures, with the targets beside them."""
    parser = argparse.ArgumentParser(description="Kill every process of a server in turn under a controller at 1 kHz.")
    parser.add_argument("--n", type=int, default=200)
    given = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="kilter-kills-"))
    found, step, _ = campaign(folder, given.n, lambda line: print(line, flush=True))
    print(f"log: {folder / 'server.log'}\nlongest bypass after each kill, ms (target: at most 300)")
    for victim in sorted({kill.victim for kill in found}):
        ms = sorted(kill.bypass_s * 1e3 for kill in found if kill.victim == victim)
        held = max(kill.held_s * 1e3 for kill in found if kill.victim == victim)
        every = max(kill.all_s * 1e3 for kill in found if kill.victim == victim)
        times = f"median {statistics.median(ms):.0f}, longest {ms[-1]:.0f}; held {held:.0f}; all {every:.0f}"
        print(f"  {victim}: {len(ms)} kills, {times}")
    print(f"largest change of a correction: {step:.2f} of what its rate allows (target: at most 1)")


if __name__ == "__main__":
    main()
