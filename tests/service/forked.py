"""Processes of `kilterd` and `kilter` as forks of one that has imported them: like any other, seconds of imports sooner.

`ForkedPopen` is a `subprocess.Popen` whose process is a fork of `tests/service/fork_server.py`, one for all processes that run
the tests. A server's own processes are then forks too. What is tested of Python's start itself (preloaded libraries, the
command line that the system shows, `python -m`) needs a process of its own.
"""

from __future__ import annotations

import atexit
import multiprocessing
import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from json import dumps, loads  # as they are now: a test may replace them
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[2]
DEADLINE_S = 240.0
KILTERD = [sys.executable, "-m", "kilter_service"]
KILTER = [sys.executable, "-c", "from kilter_client.cli import main; main()"]
# What is asked for beside commands of the server: `kilter`, the fork server of a corrector, a connection that keeps the
# server, numbers.
CLIENT, CORRECTOR_FORKS, STAY, CPU, CHILDREN = "kilter", "the forks of a corrector", "stay", "cpu", "children"
ASKER: int | None = None  # to whom the processor time counts, of a process that was forked; of any other it is itself
_RUN_ID = "RUN_OF_THE_TESTS"
_RUN = os.environ.get(_RUN_ID) or str(os.getpid())
_ADDRESS = f"\0kilter-tests-{os.getuid()}-{_RUN}"
_LIMIT = 10.0
_stay: list[socket.socket] = []


class ForkedPopen(subprocess.Popen[Any]):
    """`subprocess.Popen` of `[*KILTERD, ...]` or `[*KILTER, ...]`."""

    _connection: socket.socket

    def _execute_child(
        self, args: Any, executable: Any, preexec_fn: Any, close_fds: Any, pass_fds: Any, cwd: Any, env: Any,
        startupinfo: Any, creationflags: Any, shell: Any, p2cread: int, p2cwrite: int, c2pread: int, c2pwrite: int,
        errread: int, errwrite: int, restore_signals: Any, gid: Any, gids: Any, uid: Any, umask: int,
        start_new_session: bool, process_group: Any,
    ) -> None:  # fmt: skip
        program, arguments = list(map(str, args[:3])), list(map(str, args[3:]))
        assert program in (KILTERD, KILTER), args
        ends = ((p2cread, 0), (c2pwrite, 1), (errwrite, 2))
        places = {place: place if end == -1 else end for end, place in ends} | {fd: fd for fd in pass_fds}
        self._connection, self.pid = _fork(
            arguments[0] if program == KILTERD else CLIENT, arguments, places, environment=os.environ if env is None else env,
            folder=cwd or os.getcwd(), umask=umask, session=start_new_session,
        )  # fmt: skip
        self._child_created = True
        self._close_pipe_fds(p2cread, p2cwrite, c2pread, c2pwrite, errread, errwrite)

    def _internal_poll(self, _deadstate: Any = None, **_: Any) -> int | None:
        if self.returncode is None:
            self.returncode = _ended(self._connection, 0.0)
        return self.returncode

    def _wait(self, timeout: float | None) -> int:
        if self.returncode is None:
            self.returncode = _ended(self._connection, timeout)
        if self.returncode is None:
            raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
        return int(self.returncode)


class _ForksOfCorrector:
    """As `multiprocessing.Process` is used for the process that forks those of a corrector."""

    def __init__(self, target: Any, args: tuple[Connection], name: str) -> None:
        assert target.__name__ == "fork_server_main"
        self._orders, self.name = args[0], name
        self._connection: socket.socket | None = None
        self.pid: int | None = None
        self._code: int | None = None

    def start(self) -> None:
        """Have it forked."""
        places = {place: place for place in range(3)} | {3: self._orders.fileno()}
        self._connection, self.pid = _fork(CORRECTOR_FORKS, [], places)

    def join(self, timeout: float | None = None) -> None:
        """Wait until it has ended."""
        if self._connection is not None and self._code is None:
            self._code = _ended(self._connection, timeout)

    def is_alive(self) -> bool:
        """Whether it runs."""
        self.join(0.0)
        return self._code is None

    def kill(self) -> None:
        """End it at once."""
        if self.pid is not None and self.is_alive():
            os.kill(self.pid, 9)


def fork_those_of_correctors() -> None:
    """Have correctors in this process fork theirs as forks of what has imported already."""
    from kilter_service.stream.corrector import fork_server

    own = SimpleNamespace(Pipe=multiprocessing.Pipe, Process=_ForksOfCorrector)
    vars(fork_server)["multiprocessing"] = SimpleNamespace(Pipe=multiprocessing.Pipe, get_context=lambda _: own)


def forked_worker(environment: Mapping[str, str], folder: Path) -> ForkedPopen:
    """Return a worker that is started."""
    return ForkedPopen([*KILTERD, "worker"], env=environment, cwd=folder)


def forked_command(
    *arguments: str, environment: Mapping[str, str], folder: Path, umask: int = -1, deadline_s: float = DEADLINE_S
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end, as `subprocess.run` would."""
    with ForkedPopen(
        [*KILTERD, *arguments], env=environment, cwd=folder, umask=umask, text=True, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        try:
            out, err = process.communicate(timeout=deadline_s)
        except subprocess.TimeoutExpired as error:
            process.kill()
            said = process.communicate()[1]
            raise AssertionError(f"kilterd {' '.join(arguments)} does not end: {said}") from error
        return subprocess.CompletedProcess(arguments, process.returncode, out, err)


def used_s() -> float:
    """Processor time of the processes that this one asked for, and of theirs."""
    return float(_ask(_stay[0], CPU, ASKER or os.getpid())) if _stay else 0.0


def children_of(pid: int) -> dict[str, int]:
    """Process ids of the processes that a forked one started, by command."""
    with _connected() as connection:
        return dict(_ask(connection, CHILDREN, pid))


def _ask(connection: socket.socket, what: str, asker: int) -> Any:
    connection.send(dumps({"run": what, "asker": asker}).encode())
    return loads(connection.recv(1 << 16))


def _fork(
    name: str, arguments: list[str], places: Mapping[int, int], *, environment: Mapping[str, str] | None = None,
    folder: Any = ".", umask: int = -1, session: bool = False,
) -> tuple[socket.socket, int]:  # fmt: skip
    """Ask for a process whose file with each number is the one of this process; returns its connection and its id."""
    if not _stay:
        _stay.append(_connected())
        atexit.register(_stay[0].close)
        _stay[0].send(dumps({"run": STAY}).encode())
    connection = _connected()
    asked = {
        "run": name, "arguments": arguments, "places": list(places), "asker": ASKER or os.getpid(), "parent": os.getpid(),
        "session": session, "umask": umask,
        "environment": dict(os.environ if environment is None else environment), "folder": os.path.abspath(folder),
    }  # fmt: skip
    socket.send_fds(connection, [dumps(asked).encode()], list(places.values()))
    return connection, int(loads(connection.recv(64)))


def _ended(connection: socket.socket, timeout: float | None) -> int | None:
    """Exit code, negative for a signal; None when it has not ended in time."""
    if not select.select([connection], [], [], timeout)[0]:
        return None
    said = connection.recv(64)
    connection.close()
    return int(loads(said)) if said else -9  # the server was killed, and nobody knows any more


def _connected() -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    deadline = time.monotonic() + _LIMIT
    while True:
        try:
            connection.connect(_ADDRESS)
        except ConnectionRefusedError:  # nobody listens, or not yet
            assert time.monotonic() < deadline, "the process that forks does not listen"
            with suppress(OSError):  # another has just begun
                _start_server()
        else:
            return connection


def _start_server() -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(_ADDRESS)
        listener.listen(128)
        listener.set_inheritable(True)
        path = os.pathsep.join(filter(None, (str(REPOSITORY), os.environ.get("PYTHONPATH"))))
        os.posix_spawn(  # nobody waits for it: it ends with the last connection, of whichever process
            sys.executable,
            [sys.executable, "-m", "tests.service.fork_server", str(listener.fileno())],
            {**os.environ, _RUN_ID: _RUN, "PYTHONPATH": path, "JE_ARROW_MALLOC_CONF": "background_thread:false"},
            file_actions=[(os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0)],
        )
