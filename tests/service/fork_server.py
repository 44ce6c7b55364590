"""The process that `tests/service/forked.py` has fork processes of Kilter: it imports what they need once, and forks.

It has neither a thread (Arrow's allocator is told to have none) nor a zenoh session. A connection asks for one process: it
is told its id, and its exit code once it ended. The server ends with the last connection.
"""

from __future__ import annotations

import atexit
import fcntl
import gc
import importlib
import json
import os
import pkgutil
import resource
import selectors
import signal
import socket
import struct
import sys
import threading
import traceback
from collections import Counter
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from multiprocessing.connection import Connection
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, NoReturn

import kilter_core
from kilter_client.cli import main as kilter
from kilter_service.run import compiling
from tests.service import forked

MOST_BYTES, MOST_FDS = 1 << 18, 32
RESERVED = 64  # file descriptors below the limit, where received ones are put out of the way of their places
ORDERS = 3  # where the fork server of a corrector finds the pipe of its orders

IMPORTED = (
    *(f"kilter_client.bridges.{name}" for name in ("running", "egm", "fci")),
    "kilter_service.jobs.work.worker",
    "kilter_service.run.app",
    "kilter_service.run.backup.upgrade",
    "kilter_service.run.program",
    "kilter_service.run.supervisor",
    "kilter_service.web.gate",
    *(f"kilter_service.stream.corrector.{name}" for name in ("process", "fast_path", "loop", "queries")),
    "pyarrow.dataset",
    "pyarrow.parquet",
    "httpx",
    "uvicorn",
)


def _import_and_load() -> None:
    """Import what processes of Kilter need, now or for a job, and load all kernels: each would take 3 s for both."""
    gc.disable()
    for module in pkgutil.walk_packages(kilter_core.__path__, "kilter_core."):
        importlib.import_module(module.name)
    for name in IMPORTED:
        importlib.import_module(name)
    with redirect_stdout(None):
        compiling.compile_kernels()
    gc.freeze()
    gc.enable()


class Asked(NamedTuple):
    """A process that runs: by which name, for which tests and for which process, and who is told of its end."""

    name: str
    asker: int
    parent: int
    connection: socket.socket


class Server:
    """Forks what is asked for."""

    def __init__(self, listener: socket.socket) -> None:
        self._listener = listener
        self._selector = selectors.DefaultSelector()
        self._open: set[socket.socket] = set()
        self._running: dict[int, Asked] = {}  # by process id
        self._used_s: Counter[int] = Counter()

    def run(self) -> None:
        """Serve until nobody is connected any more."""
        _import_and_load()
        woken, wakes = os.pipe()
        for end in (woken, wakes):
            os.set_blocking(end, False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.set_wakeup_fd(wakes)
        self._selector.register(self._listener, selectors.EVENT_READ, self._accept)
        self._selector.register(woken, selectors.EVENT_READ, lambda: self._ended(woken))
        while True:
            for key, _ in self._selector.select():
                act: Callable[[], None] = key.data
                act()
            if not self._open:
                return

    def _accept(self) -> None:
        connection, _ = self._listener.accept()
        user = struct.unpack("3i", connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))[1]
        if user != os.getuid():
            connection.close()
            return
        self._open.add(connection)
        self._selector.register(connection, selectors.EVENT_READ, lambda: self._asks(connection))

    def _asks(self, connection: socket.socket) -> None:
        data, fds, *_ = b"", []
        with suppress(OSError):  # or it has ended meanwhile, and its connection with it
            data, fds, *_ = socket.recv_fds(connection, MOST_BYTES, MOST_FDS)
        if not data:
            self._let_go(connection)
            return
        asked = json.loads(data)
        if asked["run"] == forked.CPU:
            connection.send(json.dumps(self._used_s[asked["asker"]] + self._using_s(asked["asker"])).encode())
            return
        if asked["run"] == forked.CHILDREN:
            connection.send(json.dumps(self._children(asked["asker"])).encode())
            return
        if asked["run"] == forked.STAY:
            return
        pid = os.fork()
        if pid == 0:
            _be(asked, fds)
        for fd in fds:
            os.close(fd)
        self._running[pid] = Asked(asked["run"], asked["asker"], asked["parent"], connection)
        connection.send(json.dumps(pid).encode())

    def _ended(self, woken: int) -> None:
        os.read(woken, 4096)
        with suppress(ChildProcessError):
            while True:
                pid, status, used = os.wait4(-1, os.WNOHANG)
                if pid == 0:
                    return
                asked = self._running.pop(pid)
                self._used_s[asked.asker] += used.ru_utime + used.ru_stime
                with suppress(OSError):  # nobody waits for it any more
                    asked.connection.send(json.dumps(os.waitstatus_to_exitcode(status)).encode())
                self._let_go(asked.connection)

    def _using_s(self, asker: int) -> float:
        """Processor time of those that still run: the server of a session works for one test after the other."""
        ticks = 0
        for pid in (pid for pid, asked in self._running.items() if asked.asker == asker):
            with suppress(OSError):  # where there is no /proc they count where they end
                after_name = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
                ticks += sum(map(int, after_name[11:13]))  # utime, stime
        return ticks / os.sysconf("SC_CLK_TCK")

    def _children(self, parent: int) -> dict[str, int]:
        return {asked.name: pid for pid, asked in self._running.items() if asked.parent == parent}

    def _let_go(self, connection: socket.socket) -> None:
        if connection in self._open:
            self._open.remove(connection)
            self._selector.unregister(connection)
            connection.close()


def _be(asked: dict[str, Any], fds: list[int]) -> NoReturn:
    """Be the process that was asked for, and end as the interpreter ends."""
    code = 1
    try:
        signal.set_wakeup_fd(-1)
        for number in (signal.SIGCHLD, signal.SIGINT):
            signal.signal(number, signal.SIG_DFL if number == signal.SIGCHLD else signal.default_int_handler)
        _place(fds, asked["places"])
        if asked["session"]:
            os.setsid()
        os.environ.clear()
        os.environ.update(asked["environment"])
        os.chdir(asked["folder"])
        if asked["umask"] >= 0:
            os.umask(asked["umask"])
        forked.ASKER = asked["asker"]
        _run(asked["run"], asked["arguments"])
        code = 0
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else int(error.code is not None)
        if isinstance(error.code, str):
            print(error.code, file=sys.stderr)
    except BaseException:
        traceback.print_exc()
    _end(code)


def _place(fds: list[int], places: list[int]) -> None:
    """Give each file its number, and close all else: a pipe must end with the process that holds it."""
    high = min(resource.getrlimit(resource.RLIMIT_NOFILE)[0], 1 << 16) - RESERVED
    aside = [fcntl.fcntl(fd, fcntl.F_DUPFD, high) for fd in fds]
    os.closerange(3, high)
    for fd, place in zip(aside, places, strict=True):
        os.dup2(fd, place)
        os.close(fd)


def _run(name: str, arguments: list[str]) -> None:
    if name == forked.CORRECTOR_FORKS:
        from kilter_service.stream.corrector.fork_server import fork_server_main

        fork_server_main(Connection(ORDERS))
        return
    if name == forked.CLIENT:
        sys.argv = ["kilter", *arguments]
        kilter()
        return
    from kilter_service import __main__

    sys.argv = [str(__main__.__file__), *arguments]
    sys.modules["__main__"] = __main__  # what a spawned process imports again
    if name == "serve":
        from kilter_service.run import supervisor

        own = {"Popen": forked.ForkedPopen}
        vars(supervisor)["subprocess"] = SimpleNamespace(**{**vars(supervisor.subprocess), **own})
    if name == "corrector":
        forked.fork_those_of_correctors()
    __main__.main(arguments)


def _end(code: int) -> NoReturn:
    with suppress(BaseException):
        threading._shutdown()
        atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


if __name__ == "__main__":
    # Under its name: what is asked for must find the module that it finds.
    from tests.service.fork_server import Server as ServerOfForks

    ServerOfForks(socket.socket(fileno=int(sys.argv[1]))).run()
