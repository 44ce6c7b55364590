"""The process beside a bridge: follows the server, publishes the bridge's state over zenoh, and says it to people.

It may hang or be killed: the bridge goes on with the version it has.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

from kilter_client.bridges.announced import Announcer
from kilter_client.bridges.news import Kind, Line
from kilter_client.bridges.versions import Followed, poll_server
from kilter_client.streaming.corrector import StreamError, find_corrector, robot_key_prefix, session_config

POLL_S = 1.0
SILENT_S = 5.0  # without an answer of the server, which is said then: a request may be repeated for longer


@dataclass(frozen=True)
class Task:
    """What the companion of a bridge does; ``version`` None follows the active one."""

    robot: str
    bridge: str
    version: str | None
    number: str  # of the version that the bridge started with, hexadecimal
    force: bool
    quiet: bool
    publish: str  # zenoh endpoint to listen on

    def text(self) -> str:
        """As an argument of the process."""
        return json.dumps(asdict(self))


class Companion:
    """Follows the server in a thread of its own; the main thread passes the state on."""

    def __init__(self, line: Line, task: Task) -> None:
        self._line, self._task = line, task
        self._ended = threading.Event()
        self._said = self._server = ""
        self._problem, self._answered_s = "", time.monotonic()
        self._announcer = Announcer(task.robot, secrets.token_hex(8), lambda text: _print_unless_quiet(task, text))

    def run(self) -> None:
        """Work until the bridge ends."""
        threading.Thread(target=self._follow, name="versions", daemon=True).start()
        last = "killed"
        with _publisher(self._task) as publish:
            while not self._line.cut:
                select.select([self._line], [], [], 1.0)
                self._say_of_server()
                while (packet := self._line.receive()) is not None:
                    if packet[0] is Kind.END:
                        last = "ended"
                        continue
                    document = json.loads(packet[1]) | {"robot": self._task.robot, "bridge": self._task.bridge}
                    publish(json.dumps(document).encode())
                    self._announcer.update_state(document)
                    self._print_if_changed(document)
            publish(json.dumps({"robot": self._task.robot, "bridge": self._task.bridge, "state": last}).encode())
        self._ended.set()
        self._announcer.close(last)

    def _follow(self) -> None:
        known = Followed(self._task.number)
        while not self._ended.wait(POLL_S):
            known, news, self._problem = poll_server(self._task.robot, self._task.version, self._task.force, known)
            self._answered_s = time.monotonic()
            for kind, text in news:
                while not self._line.send(kind, text) and not self._line.cut:
                    time.sleep(0.01)

    def _say_of_server(self) -> None:
        problem = self._problem
        if time.monotonic() - self._answered_s > SILENT_S:
            problem = f"the server has not answered for {SILENT_S:.0f} s, and the version goes on"
        if problem != self._server and self._line.send(Kind.SERVER, problem.encode()):
            self._server = problem

    def _print_if_changed(self, document: dict[str, Any]) -> None:
        version = document["version_id"]
        text = f"{document['bridge']} bridge of {document['robot']}: {document['state']}, {version}"
        text += f": {document['why']}" if document["why"] else ""
        text += f" ({document['server']})" if document["server"] else ""
        if text != self._said:
            _print_unless_quiet(self._task, text)
        self._said = text


@contextlib.contextmanager
def _publisher(task: Task) -> Iterator[Callable[[bytes], object]]:
    """What publishes the state; nothing where there is no zenoh, or the endpoint cannot be had."""
    try:
        import zenoh

        endpoint = _with_port(task.publish)
        session = zenoh.open(_listening(zenoh, endpoint))
    except (ImportError, OSError, ValueError, StreamError) as error:
        _print_unless_quiet(task, f"The state is not published: {error}")
        yield lambda _: None
        return
    except zenoh.ZError as error:
        _print_unless_quiet(task, f"The state is not published on {task.publish}: {error}")
        yield lambda _: None
        return
    try:
        key = f"{robot_key_prefix(_site(), task.robot, task.bridge)}/bridge/{task.bridge}"
        publisher = session.declare_publisher(key)
        _print_unless_quiet(task, f"The state is published on {endpoint} as {key}.")
        yield publisher.put
    finally:
        session.close()  # type: ignore[no-untyped-call]


def _site() -> str:
    try:
        return str(find_corrector()["site"])
    except (StreamError, KeyError):
        return "local"


def _with_port(endpoint: str) -> str:
    """Replace port 0 of ``tcp/host:0`` by a free one, so that it can be told."""
    address, _, port = endpoint.rpartition(":")
    if port != "0":
        return endpoint
    with socket.create_server((address.partition("/")[2].strip("[]"), 0)) as probe:
        return f"{address}:{probe.getsockname()[1]}"


def _listening(zenoh: Any, endpoint: str) -> Any:
    config = session_config(zenoh, ())
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    return config


def _print_unless_quiet(task: Task, text: str) -> None:
    if not task.quiet:
        print(text, file=sys.stderr, flush=True)


def _leave_real_time() -> None:
    """Give back the real-time priority of a bridge: the loop shall not wait for what is beside it."""
    if hasattr(os, "sched_getscheduler") and os.sched_getscheduler(0) in (os.SCHED_FIFO, os.SCHED_RR):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def main() -> None:
    """Run as a process: file descriptor and task are its arguments."""
    _leave_real_time()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the bridge says when it is over
    end = socket.socket(fileno=int(sys.argv[1]))
    Companion(Line(end), Task(**json.loads(sys.argv[2]))).run()


if __name__ == "__main__":
    main()
