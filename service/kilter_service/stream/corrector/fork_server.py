"""Where the processes of the corrector are born: a process that has imported and compiled what they need, and forks them.

To import numba and to load the kernels takes a second of processor time. So it is done once for both, and a process that
was killed is there again at once. Forked is only this process, which has no thread and no zenoh session: a fork of a
process with a zenoh session hangs.
"""

from __future__ import annotations

import gc
import logging
import multiprocessing
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from multiprocessing.reduction import recv_handle, send_handle
from typing import Any, NamedTuple, NoReturn

from kilter_service.ground.child_process import Child, running
from kilter_service.ground.core import core_correct
from kilter_service.ground.errors import ServiceError
from kilter_service.stream.corrector.session import Found, QuerySpec, StreamSpec, enter

log = logging.getLogger("kilter.corrector")

POLL_S = 0.25
START_S = 300.0  # the first start on a machine compiles the kernel, on a busy one for minutes
FORK_S = (
    5.0  # a fork takes milliseconds, on a busy machine a second; one that imported and does not fork for so long hangs
)
STOPPED_S = 5.0  # one that is stopped from outside for so long is given up
MOST_ORDERS = 3  # of one process; a fork server that ended so often ends the same the next time
STOP_S = 5.0
LOOK_S = 0.005


class StoppedError(Exception):
    """The corrector was stopped before its processes listened."""


class Forked(NamedTuple):
    """A process of the corrector, at the other end of a pipe, and its id once it has told it."""

    pipe: Connection
    pid: int | None = None


class ForkServer:
    """The process that forks the others, from its first order to :meth:`stop`.

    One is forked ahead and waits to be told what to be: so nothing is lost when the stream's process is killed just after this
    one was, while the next of its kind still imports.
    """

    def __init__(self) -> None:
        self._process: BaseProcess | None = None
        self._pipe: Connection | None = None
        self._seen_at = 0.0  # when it was last seen not to be stopped from outside
        self._ready_at: float | None = None  # it has imported, and forks at once
        self._spare: Forked | None = None

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process is not None and self._process.is_alive()

    @property
    def pid(self) -> int | None:
        """Process id."""
        return self._process.pid if self._process else None

    def start(self) -> None:
        """Start the process, if it does not run or is stopped from outside; it imports and compiles by itself."""
        if self.alive:
            self._poll_readiness()
            if time.monotonic() - self._seen_at < STOPPED_S:
                return
        if self._process is not None:
            log.error("the process that starts those of the corrector ended or is frozen: it is restarted")
            self.stop()
        context = multiprocessing.get_context("spawn")  # whoever makes the corrector may have threads
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=fork_server_main, args=(theirs,), name="kilter-nursery")
        self._process.start()
        self._seen_at, self._ready_at = time.monotonic(), None
        theirs.close()

    def keep_spare(self) -> None:
        """Have a process forked ahead, if there is none."""
        if self._spare is not None and not is_pipe_closed(self._spare.pipe):
            return
        self._drop_spare()
        self._spare = Forked(self._fork())

    def stop_if_frozen(self, asked_at: float) -> None:
        """End the process when it is stopped, or has not forked what was asked for; while it imports that may take long."""
        if not self.alive:
            return
        self._poll_readiness()
        now = time.monotonic()
        hangs = self._ready_at is not None and now - max(asked_at, self._ready_at) > FORK_S
        if hangs or now - self._seen_at > STOPPED_S:
            log.error("the process that starts those of the corrector is frozen: it is killed")
            self.stop()

    def _poll_readiness(self) -> None:
        if running(self.pid):
            self._seen_at = time.monotonic()
        with suppress(EOFError, OSError):
            if self._ready_at is None and self._pipe is not None and self._pipe.poll():
                self._pipe.recv()
                self._ready_at = time.monotonic()

    @property
    def spare_pid(self) -> int | None:
        """Process id of the one forked ahead, once it has told it."""
        if self._spare is None:
            return None
        with suppress(EOFError, OSError):
            if self._spare.pid is None and self._spare.pipe.poll():
                self._spare = self._spare._replace(pid=int(self._spare.pipe.recv()))
        return self._spare.pid

    def order(self, entry: str, spec: StreamSpec | QuerySpec) -> Forked:
        """Order a process; its pipe is closed at the other end when the process is gone."""
        self.start()
        spare = self._spare if running(self.spare_pid or 0) else None
        if spare is None:
            made = Forked(self._fork())
        else:
            made, self._spare = self._spare or spare, None
        with suppress(OSError):  # gone meanwhile
            made.pipe.send((entry, spec))
        return made

    def _fork(self) -> Connection:
        assert self._pipe is not None
        ours, theirs = multiprocessing.Pipe()
        with theirs, suppress(OSError):  # a fork server that has just ended: nobody holds the other end
            send_handle(self._pipe, theirs.fileno(), self.pid)
        return ours

    def _drop_spare(self) -> None:
        if self._spare is not None:
            self._spare.pipe.close()
            self._spare = None

    def close(self) -> None:
        """End the process, and the one forked ahead; the others go on."""
        self._drop_spare()
        self.stop()

    def stop(self) -> None:
        """End the process; those it forked go on."""
        if self._process is not None and self._pipe is not None:
            self._pipe.close()
            self._process.kill()  # it may be compiling; it holds nothing that must be put in order
            self._process.join()
        self._process = self._pipe = None


def fork_server_main(orders: Connection) -> None:
    """Entry of the fork server: fork what is ordered until nobody can order any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the system buries them
    gc.disable()  # all that is made now lasts: a fifth of the time to import it was looking for garbage
    from kilter_service.stream.corrector import fast_path, loop, queries  # noqa: F401  # the forked need not import them

    core_correct.warm_up()
    fast_path.warm_up()
    gc.collect()
    gc.freeze()  # what is never looked at stays shared
    gc.enable()
    with suppress(EOFError, OSError):
        orders.send(True)
        while True:
            pipe = Connection(recv_handle(orders))
            if os.fork() == 0:
                orders.close()
                _run_child(pipe)
            pipe.close()


def _run_child(pipe: Connection) -> NoReturn:
    """Be the process that was ordered; its pipe is open for as long as it lives."""
    code = 1
    try:
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        with suppress(BrokenPipeError, ConnectionResetError, EOFError):  # whoever ordered it is gone: nothing to do
            pipe.send(os.getpid())
            entry, spec = pipe.recv()
            enter(entry, spec, pipe)
        code = 0
    except BaseException:
        log.exception("a process of the corrector ends")
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


class ForkedChild(Child):
    """A process of the corrector at the other end of a pipe: it alone holds that end, so it runs while the pipe is open."""

    first_pause_s = longest_pause_s = 0.0  # each millisecond is one that an arm is not corrected for

    def __init__(
        self, name: str, entry: str, spec: StreamSpec | QuerySpec, server: ForkServer, found: Found | None = None
    ) -> None:
        super().__init__(name)
        self._entry = entry
        self._spec = spec
        self._fork_server = server
        self._pipe: Connection | None = None
        self._listens = False
        self._asked_at = 0.0
        if found is not None:  # it listens already, and was started by a corrector that is gone
            self.pid, self._pipe, self._listens = found.pid, found.pipe, True

    def _launch(self) -> None:
        """Order the process."""
        self._listens = False
        self._pipe, self.pid = self._fork_server.order(self._entry, self._spec)
        self._asked_at = time.monotonic()

    def listening(self, stopped: Callable[[], bool] = lambda: False) -> tuple[str | None, bool]:
        """Wait until the process listens; returns its endpoint, if it has one, and whether it runs in real time.

        Raises:
            ServiceError: it may not listen on its endpoint.
            RuntimeError: it ended or did not listen in time.
            StoppedError: ``stopped`` said so first.

        """
        try:
            self.pid = self.pid or self._await_pid(stopped)
            if self.pid is not None and self._comes(stopped):
                verdict, endpoint, real_time = self._receive()
                if verdict == "refused":
                    self.stop()
                    raise ServiceError(endpoint, code="binding_refused")
                self._listens = True
                if isinstance(self._spec, StreamSpec):  # after a restart it listens where its clients look for it
                    self._spec = replace(self._spec, again=endpoint)
                return endpoint, bool(real_time)
        except (EOFError, OSError) as error:
            log.warning("%s, process %s, ended before it listened (%r)", self.name, self.pid, error)
        self.stop()
        raise RuntimeError(f"The {self.name} process of the corrector did not start; its messages are above.")

    def _await_pid(self, stopped: Callable[[], bool]) -> int | None:
        """Wait until the process was forked; it is ordered again when the fork server is gone or frozen."""
        for left in reversed(range(MOST_ORDERS)):
            try:
                if self._comes(stopped, lambda: self._fork_server.stop_if_frozen(self._asked_at)):
                    return int(self._receive())
            except (EOFError, OSError) as error:
                if not left:
                    raise
                log.warning("%s was not forked (%r): it is ordered again", self.name, error)
                self.stop()
                self._fork_server.stop()  # nobody holds the other end, so it ends: it may not be known to have ended
                self.start()
        return None

    def _receive(self) -> Any:
        assert self._pipe is not None
        return self._pipe.recv()

    def _comes(self, stopped: Callable[[], bool], meanwhile: Callable[[], None] = lambda: None) -> bool:
        """Wait for the next message; False when none came in time."""
        assert self._pipe is not None
        end = time.monotonic() + START_S
        while not self._pipe.poll(POLL_S):
            if stopped():
                raise StoppedError
            if time.monotonic() > end:
                return False
            meanwhile()
        return True

    @property
    def pipe(self) -> Connection | None:
        """This end of its pipe."""
        return self._pipe

    @property
    def listens(self) -> bool:
        """Whether the process has said that it listens."""
        return self._listens

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._pipe is not None and not is_pipe_closed(self._pipe)

    def send(self, *message: Any) -> None:
        """Tell the process something; the supervisor restarts a process that is gone."""
        if self._pipe is not None:
            try:
                self._pipe.send(message)
            except OSError:
                log.warning("the %s process is gone", self.name)

    def heard(self) -> Iterator[tuple[Any, ...]]:
        """What the process has said since; a process that is gone says nothing."""
        try:
            while self._pipe is not None and self._listens and self._pipe.poll():
                yield self._pipe.recv()
        except (EOFError, OSError):
            return

    def _how_it_ended(self) -> tuple[str, bool]:
        return "ended", True  # who forked it learns no exit code

    def stop(self) -> None:
        """Ask the process to stop, and end it when it does not; one that does not listen yet has nothing to put in order."""
        if self._listens and self.alive:
            self.ask_to_stop()
            self.wait(time.monotonic() + STOP_S)
        else:
            self._kill()
            self._close()

    def ask_to_stop(self) -> None:
        """Say so through the pipe."""
        self.send("stop")

    def _kill(self) -> None:
        if self.pid is not None and self.alive:
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
            self._wait_until_ended(STOP_S)

    def _close(self) -> None:
        if self._pipe is not None:
            self._pipe.close()  # one that has not begun yet ends when it finds nobody there
        self._pipe = None

    def _wait_until_ended(self, seconds: float) -> bool:
        end, pause = time.monotonic() + seconds, threading.Event()
        while self.alive or _exists(self.pid):
            if time.monotonic() > end:
                return not self.alive
            pause.wait(LOOK_S)
        return True


def is_pipe_closed(pipe: Connection) -> bool:
    """Whether nobody holds the other end of a pipe any more."""
    looked = select.poll()
    looked.register(pipe, 0)
    return bool(looked.poll(0))


def _exists(pid: int | None) -> bool:
    """Whether the system still knows a process; its pipe is closed a moment before it forgets it."""
    if pid is None:
        return False
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True
