"""Work on what strangers sent, in a process of its own with limits of time, memory and output.

The process starts with a clean environment in a folder for a while. Whatever it runs into, the server goes on.
"""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.processes.memory import end_before_others

LIMITS = "KILTER_CHILD_LIMITS"
LAST_WORDS = 4000
STRANGERS = 1000  # of the kernel's scores: before a worker, and long before what corrects an arm
# Several threads would count their stacks against the memory, and there is one slot.
PLAIN = {
    "PATH": "/usr/bin:/bin",
    "LC_ALL": "C.UTF-8",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "ARROW_DEFAULT_MEMORY_POOL": "system",
    "ARROW_NUM_THREADS": "1",
    "PYTHONDONTWRITEBYTECODE": "1",
    "MALLOC_ARENA_MAX": "2",
}


@dataclass(frozen=True)
class Limits:
    """``seconds`` of time, ``memory_mb`` of address space, ``output_mb`` of each file that is written."""

    seconds: int = 60
    memory_mb: int = 2048
    output_mb: int = 512


@dataclass(frozen=True)
class Ended:
    """How a process ended: its exit code, whether the time was up, and its last words."""

    code: int
    late: bool
    words: str

    @property
    def lacked_memory(self) -> bool:
        """Whether it ended for want of memory."""
        return "MemoryError" in self.words or "bad_alloc" in self.words or self.code == -signal.SIGKILL


def run(module: str, folder: Path, arguments: Sequence[str], limits: Limits, environment: Sequence[str] = ()) -> Ended:
    """Run a module of ours in a folder; it calls `confine` before it does anything.

    ``environment`` names variables that it is given beside the plain ones, and beside the one by which sums are rounded.
    """
    given = {name: os.environ[name] for name in ("OPENBLAS_CORETYPE", *environment) if name in os.environ}
    told = ",".join(str(value) for value in asdict(limits).values())
    with (folder / "words").open("wb") as words:
        process = subprocess.Popen(
            [sys.executable, "-I", "-m", module, *arguments],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=words,
            stderr=words,
            start_new_session=True,
            env={**PLAIN, **given, "TMPDIR": str(folder), LIMITS: told},
        )
        late = False
        try:
            code = process.wait(limits.seconds)
        except subprocess.TimeoutExpired:
            late, code = True, -signal.SIGKILL
        finally:
            _kill_process_group(process)
    return Ended(code, late or code == -signal.SIGXCPU, _read_output_tail(folder / "words"))


def _kill_process_group(process: subprocess.Popen[bytes]) -> None:
    """End it with whatever it started: the process leads a group of its own."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _read_output_tail(path: Path) -> str:
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - LAST_WORDS))
        return file.read().decode("utf-8", "replace")


def confine() -> Limits:
    """Take the limits upon this process; the first thing that a module does which is run so.

    Raises:
        ServiceError: it was not started by `run`.

    """
    told = os.environ.get(LIMITS)
    if told is None:
        raise ServiceError("This module is started by the server alone.", code="payload_invalid")
    limits = Limits(*(int(value) for value in told.split(",")))
    for what, most in (
        (resource.RLIMIT_AS, limits.memory_mb << 20),
        (resource.RLIMIT_CPU, limits.seconds),
        (resource.RLIMIT_FSIZE, limits.output_mb << 20),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_NOFILE, 256),
    ):
        resource.setrlimit(what, (most, most))
    os.nice(5)
    end_before_others(STRANGERS)
    return limits
