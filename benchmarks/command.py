"""What a `kilter` command takes of its own: processor time of its process, the server's not counted."""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.table import Line
from kilter_client.requests.local_server import local_server

TARGET_S, ROUNDS = 0.3, 5
MEASURED = Path(__file__).resolve().parents[1] / "docs" / "tutorial" / "measured.csv"
PROGRAM = str(Path(sys.executable).with_name("kilter"))


def lines() -> list[Line]:
    """The shortest of some runs; wall time on a quiet machine is this and what the server takes."""
    with tempfile.TemporaryDirectory() as folder, local_server(Path(folder)) as server:
        environment = server.environment()
        _seconds(environment, "robot", "add", "--preset", "katana450-chapter5", "--name", "arm")
        commands = (("--help",), ("versions", "arm"), ("jobs",), ("upload", "arm", str(MEASURED), "--name", "monday"))
        return list(_timed(environment, commands))


def _timed(environment: dict[str, str], commands: tuple[tuple[str, ...], ...]) -> Iterator[Line]:
    for command in commands:
        took = min(_seconds(environment, *command) for _ in range(ROUNDS))
        shown = " ".join(Path(word).name for word in command[:3])
        yield Line(f"kilter {shown}", f"{took:.2f} s", f"<= {TARGET_S:g} s", took <= TARGET_S)


def _seconds(environment: dict[str, str], *arguments: str) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([PROGRAM, *arguments], env=environment, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
