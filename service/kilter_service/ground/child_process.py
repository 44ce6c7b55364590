"""A process that another one starts, watches and stops; and work on what strangers sent, within limits.

The process starts with a clean environment in a folder for a while. Whatever it runs into, the server goes on.
"""

from __future__ import annotations

import json
import logging
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.memory import set_out_of_memory_score

log = logging.getLogger("kilter.processes")

STEADY_S = 30.0  # what ran for so long is started again at once


def stop_event() -> threading.Event:
    """Return an event that SIGTERM and Ctrl-C set from now on, instead of ending the process."""
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    return stop


class Child(ABC):
    """A process from :meth:`start` to :meth:`wait`; :meth:`watch` is called again and again in between.

    How it is started and ended is up to the class: a program, or a fork.
    """

    first_pause_s, longest_pause_s = 0.2, 10.0

    def __init__(self, name: str) -> None:
        self.name = name
        self.pid: int | None = None
        self.ending = ""  # how it ended the last time, in words
        self.ends = 0
        self._started = 0.0
        self._pause = self.first_pause_s
        self._again_at: float | None = None
        self._frozen = False

    @property
    @abstractmethod
    def alive(self) -> bool:
        """Whether the process runs."""

    @abstractmethod
    def _launch(self) -> None:
        """Start the process."""

    @abstractmethod
    def _how_it_ended(self) -> tuple[str, bool]:
        """Say how it ended, and whether somebody killed it."""

    @abstractmethod
    def ask_to_stop(self) -> None:
        """Ask the process to end in order, if it runs."""

    @abstractmethod
    def _kill(self) -> None:
        """End the process at once, if it runs."""

    @abstractmethod
    def _wait_until_ended(self, seconds: float) -> bool:
        """Wait until it has ended; False when it had not in time."""

    @abstractmethod
    def _close(self) -> None:
        """Let go of what was open to a process that has ended."""

    def start(self) -> None:
        """Start the process."""
        self._started, self._again_at, self._frozen = time.monotonic(), None, False
        self._launch()

    def watch(self) -> bool:
        """Start the process again when it has ended: soon, and more slowly when it keeps ending; whether it did."""
        if self.alive:
            self._say_if_frozen()
            return False
        time_s = time.monotonic()
        if self._again_at is None:
            self._again_at = time_s + self._pause_after(time_s - self._started)
        if time_s < self._again_at:
            return False
        self._close()
        self.start()
        return True

    def _pause_after(self, ran_s: float) -> float:
        """Say how it ended, and how long to wait with the next start."""
        self.ending, killed = self._how_it_ended()
        self.ends += 1
        log.error("%s %s: it starts again", self.name, self.ending)
        if killed or ran_s > STEADY_S:  # not by its own failure: it need not be slowed down
            self._pause = self.first_pause_s
        pause, self._pause = self._pause, min(2 * self._pause, self.longest_pause_s)
        return pause

    def _say_if_frozen(self) -> None:
        """Say that somebody stopped the process (SIGSTOP, a debugger); whoever did it may want to go on."""
        frozen = is_process_stopped(self.pid)
        if frozen == self._frozen:
            return
        self._frozen = frozen
        if frozen:
            remedy = f"`kill -CONT {self.pid}` lets it go on, after `kill -KILL {self.pid}` it starts again"
            log.error("%s is frozen (SIGSTOP or a debugger): %s", self.name, remedy)
        else:
            log.warning("%s goes on", self.name)

    def wait(self, deadline: float) -> None:
        """Wait for the end; kill the process when the deadline passes."""
        if not self._wait_until_ended(max(0.0, deadline - time.monotonic())):
            log.warning("%s did not stop: it is killed", self.name)
            self._kill()
        self._close()


def running(pid: int | None) -> bool:
    """Whether a process is not stopped (SIGSTOP, a debugger) or dead, as far as this system tells."""
    return _state(pid) not in "TtZX"


def is_process_stopped(pid: int | None) -> bool:
    """Whether somebody stopped a process. One whose threads end one after another is not: its first is dead, no more."""
    return _state(pid) in "Tt"


def _state(pid: int | None) -> str:
    """Letter of the state that Linux tells of a process, X where it has none; R where this system tells nothing."""
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii", errors="replace") as file:
            return file.read().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return "X" if os.path.isdir("/proc/self") else "R"
    except (OSError, IndexError):
        return "R"


LONGEST = 500
GRACE_S = 0.2  # children of the process may keep its output open


def _sentence(line: str) -> str:
    """What a line of a process says: of one as JSON its message, and of an error that nobody caught the error."""
    if not line.startswith("{"):
        return line.removeprefix("kilterd: ")
    try:
        said = json.loads(line)
        return str(said.get("exception", said["message"])).strip().splitlines()[-1]
    except (ValueError, KeyError, IndexError, AttributeError):
        return line


class ChildOutput:
    """Follows the output of one process after another, and knows the last line."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._line = ""
        self._thread: threading.Thread | None = None

    def follow(self, output: IO[bytes] | None) -> None:
        """Pass on what comes out until it ends."""
        assert output is not None
        self._line = ""
        self._thread = threading.Thread(
            target=self._forward_output, args=(output,), daemon=True, name=f"{self._name}-output"
        )
        self._thread.start()

    def last_line(self) -> str:
        """Return the last line, of a traceback its error, as far as the process said anything."""
        self.close()
        return self._line or "it said nothing"

    def close(self) -> None:
        """Wait until the output of a process that has ended is passed on."""
        if self._thread is not None:
            self._thread.join(GRACE_S)

    def _forward_output(self, output: IO[bytes]) -> None:
        with output:
            for line in output:
                text = line.decode(errors="replace")
                if text.strip():
                    self._line = _sentence(text.strip())[:LONGEST]
                try:
                    sys.stderr.write(text)
                    sys.stderr.flush()
                except (OSError, ValueError):
                    continue  # nobody reads this process any more; the other must not block for it


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
    set_out_of_memory_score(STRANGERS)
    return limits
