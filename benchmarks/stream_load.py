"""The corrector under load, for a long time, and killed.

    python -m benchmarks.stream_load robots [--robots 10] [--rate 500] [--seconds 20]
    python -m benchmarks.stream_load soak [--minutes 30]
    python -m benchmarks.stream_load restart [--times 5]

``robots`` holds the stream process to one core. ``soak`` streams at 1 kHz with a trajectory query a second and damaged
frames between, and watches the memory of both processes. ``restart`` kills the stream process in motion.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import zenoh

from benchmarks.stream import SITE, Fixed, Line, running
from benchmarks.stream_arm import POSTURE, ROBOT, calibration, path
from kilter_client.stream import CorrectedStream
from kilter_core.correct.program import CorrectionOptions, compile_program
from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.active import Active, version_number
from kilter_service.stream.corrector.process import Corrector
from kilter_service.stream.corrector.queries import encode_trajectory
from kilter_service.stream.corrector.session import config

GROWTH_MB = 5.0
TICK = os.sysconf("SC_CLK_TCK")


def robots_with_one_version(count: int) -> Fixed:
    """A source of several robots."""
    program = compile_program(calibration(), CorrectionOptions())
    first = Active(ROBOT, "ver_bench", version_number(program.digest), 1, program)
    return Fixed(first, *(replace(first, robot=f"arm{k}") for k in range(1, count)))


def processor_s(pid: int) -> float:
    """Processor time a process has used."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICK


def memory_mb(pid: int) -> float:
    """Resident memory of a process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def stream_pid(corrector: Corrector) -> int:
    """Process id of the stream process."""
    pid = corrector._children["stream"].pid
    assert pid is not None
    return pid


def robots(count: int, rate: float, seconds: float) -> None:
    """Several robots at once, the stream process held to one core."""
    source = robots_with_one_version(count)
    with (
        running(source) as corrector,
        zenoh.open(config("tcp/127.0.0.1:0", (corrector.endpoints["stream"],))) as session,
    ):
        pid, core = stream_pid(corrector), max(os.sched_getaffinity(0))
        for task in Path(f"/proc/{pid}/task").iterdir():
            os.sched_setaffinity(int(task.name), {core})
        lines = [Line(session, f"kilter/@v1/{SITE}/{name}/stream/main") for name in source.load()]
        used, due, late = processor_s(pid), time.perf_counter(), 0
        for k in range(round(seconds * rate)):
            due += 1.0 / rate
            left = due - time.perf_counter()
            late += left < 0.0
            time.sleep(max(0.0, left))
            for line in lines:
                line.send(path(k))
        for line in lines:
            line.wait()
        used = processor_s(pid) - used
        verdicts = Counter(wire.decode_answer(data).status.name for line in lines for _, data in line.arrived)
        trips = np.concatenate([line.round_trips_us() for line in lines])
        sent = sum(line.seq for line in lines)
        print(f"{count} robots at {rate:g} Hz for {seconds:g} s: {sent} setpoints, {dict(verdicts)}")
        print(f"round trip p50={np.percentile(trips, 50):.0f} p99={np.percentile(trips, 99):.0f} µs; {late} sent late")
        print(f"load of the machine {os.getloadavg()[0]:.1f}")
        lost = sent - sum(len(line.arrived) for line in lines)
        print(f"robots={count} core={used / seconds:.0%} lost={lost} refused={sent - lost - verdicts['OK']}")


def _tick(corrector: Corrector, session: zenoh.Session, line: Line, request: bytes) -> None:
    """What happens once a second beside the stream."""
    answers = list(session.get(f"kilter/@v1/{SITE}/{ROBOT}/@rpc/correct", payload=request, timeout=5.0))
    if not any(answer.ok is not None for answer in answers):
        raise SystemExit("the trajectory query was not answered")
    session.put(f"kilter/@v1/{SITE}/{ROBOT}/stream/rubbish/in", wire.MAGIC + os.urandom(60))
    corrector.poll()
    line.arrived.clear()  # what has been counted is let go: the memory watched is not ours, but a soak is long


def soak(minutes: float) -> bool:
    """Stream for a long time; whether memory stayed flat after the first tenth, and nothing was lost."""
    t = np.arange(1000) * 0.002
    request = encode_trajectory(t, POSTURE + 0.1 * np.sin(t)[:, None], joints=6)
    with (
        running(robots_with_one_version(1)) as corrector,
        zenoh.open(config("tcp/127.0.0.1:0", tuple(corrector.endpoints.values()))) as session,
    ):
        line = Line(session, f"kilter/@v1/{SITE}/{ROBOT}/stream/soak")
        children = {name: child.pid or 0 for name, child in corrector._children.items()}
        begin = due = time.perf_counter()
        end, seen, history = begin + 60.0 * minutes, 0, []
        while time.perf_counter() < end:
            for _ in range(1000):
                due = max(due + 0.001, time.perf_counter() - 0.1)
                time.sleep(max(0.0, due - time.perf_counter()))
                line.send(path(line.seq))
            deadline = time.perf_counter() + 3.0
            while seen + len(line.arrived) < line.seq and time.perf_counter() < deadline:
                time.sleep(0.001)
            seen += len(line.arrived)
            line.sent.clear()
            _tick(corrector, session, line, request)
            history.append([memory_mb(pid) for pid in children.values()])
            if len(history) % 60 == 0:
                print(f"{len(history) / 60:.0f} min: " + ", ".join(
                    f"{name} {now:.1f} MB" for name, now in zip(children, history[-1], strict=True)
                ), flush=True)  # fmt: skip
    settled, last = np.array(history[len(history) // 10]), np.array(history[-1])
    grown = float((last - settled).max())
    lost = line.seq - seen
    print(f"soak minutes={minutes:g} setpoints={line.seq} lost={lost} growth_mb={grown:.1f}")
    return grown <= GROWTH_MB and lost == 0


def restart(times: int) -> None:
    """Kill the stream process in motion: until the controller library notices, and until it streams again."""
    noticed, back = [], []
    with running(robots_with_one_version(1)) as corrector:
        stop = threading.Event()

        def supervise() -> None:
            while not stop.wait(0.25):  # as `kilterd corrector` does
                corrector.poll()

        supervisor = threading.Thread(target=supervise)
        supervisor.start()
        try:
            options = {"data": corrector.file.parent, "stream": "kill", "deadline_s": 0.02, "settled": True}
            with CorrectedStream(ROBOT, connect_timeout_s=20.0, **options) as stream:
                for _ in range(times):
                    while stream.correct(POSTURE).source != "corrected":
                        time.sleep(0.002)
                    killed = time.perf_counter()
                    os.kill(stream_pid(corrector), signal.SIGKILL)
                    while stream.alive:
                        time.sleep(0.0002)
                    noticed.append(time.perf_counter() - killed)
                    while stream.correct(POSTURE).source != "corrected":
                        time.sleep(0.002)
                    back.append(time.perf_counter() - killed)
        finally:
            stop.set()
            supervisor.join()
    print(f"load of the machine {os.getloadavg()[0]:.1f}")
    print(f"kill -9: noticed_ms={max(noticed) * 1e3:.1f} back_s={max(back):.2f} (largest of {times})")


def main() -> None:
    """Run one of the three."""
    parser = argparse.ArgumentParser(description="The corrector under load, for a long time, and killed.")
    commands = parser.add_subparsers(dest="command", required=True)
    many = commands.add_parser("robots")
    many.add_argument("--robots", type=int, default=10)
    many.add_argument("--rate", type=float, default=500.0)
    many.add_argument("--seconds", type=float, default=20.0)
    commands.add_parser("soak").add_argument("--minutes", type=float, default=30.0)
    commands.add_parser("restart").add_argument("--times", type=int, default=5)
    given = parser.parse_args()
    if given.command == "robots":
        robots(given.robots, given.rate, given.seconds)
    elif given.command == "restart":
        restart(given.times)
    elif not soak(given.minutes):
        sys.exit(1)


if __name__ == "__main__":
    main()
