"""A bridge from its options to its end: what is checked before, the companion beside it, signals, and what is told after."""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import secrets
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from ipaddress import IPv4Address
from typing import Any

from kilter_client.bridges import correction as versions
from kilter_client.bridges.correction import Correction, Followed, Guard, Kind, Line, pair, poll_server
from kilter_client.bridges.fci import JOINTS, Fci
from kilter_client.bridges.loop import Address, Loop, Wire
from kilter_client.bridges.plan import Setpoints
from kilter_client.client import Kilter
from kilter_client.errors import (
    FileError,
    KilterError,
    MissingPackageError,
    NotAuthorisedError,
    NotFoundError,
    UsageError,
)
from kilter_client.streaming.certificates import StreamError, find_corrector, robot_key_prefix, session_config
from kilter_client.verbs.inputs import parse_signs
from kilter_core.correct import from_bytes
from kilter_core.errors import OptionError

POLL_S = 1.0
SILENT_S = 5.0  # without an answer of the server, which is said then: a request may be repeated for longer
PERIOD_S = 2.0
LAST_S = 3.0  # for the last word of a bridge that ends


# The process beside a bridge: follows the server, publishes the bridge's state over zenoh, and says it to people.
# It may hang or be killed: the bridge goes on with the version it has.


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


class Announcer:
    """Tells the server every 2 s, and at once when the state changes, in a thread of its own: a server may be slow."""

    def __init__(self, robot: str, run: str, say: Callable[[str], object]) -> None:
        self._robot, self._run, self._say = robot, run, say
        self._news: dict[str, Any] | None = None
        self._changed, self._over = threading.Event(), False
        self._thread = threading.Thread(target=self._announce, name="announcements", daemon=True)
        self._thread.start()

    def update_state(self, document: Mapping[str, Any]) -> None:
        """Take over the state of the bridge."""
        news, before = bridge_status_document(document), self._news
        self._news = news
        if before is None or (before["state"], before["version_id"]) != (news["state"], news["version_id"]):
            self._changed.set()

    def close(self, last: str) -> None:
        """Say the last word, "ended" or "killed", if the server takes it soon."""
        if self._news is not None:
            self._news = self._news | {"state": last}
        self._over = True
        self._changed.set()
        self._thread.join(LAST_S)

    def _announce(self) -> None:
        over = False
        while not over:
            self._changed.wait(PERIOD_S)
            self._changed.clear()
            over, news = self._over, self._news
            if news is not None and not self._send_news(news):
                return

    def _send_news(self, news: Mapping[str, Any]) -> bool:
        """Tell once; False where there is no sense in telling again."""
        try:
            with Kilter() as kilter:
                kilter.robots.announce_bridge(self._robot, self._run, news)
        except (NotAuthorisedError, NotFoundError) as error:
            self._say(f"The server does not show this bridge: {error.detail}")
            return False
        except KilterError:  # it is away; the state says so already
            return True
        return True


def bridge_status_document(document: Mapping[str, Any]) -> dict[str, Any]:
    """What the server is told of a bridge's state."""
    counts: Mapping[str, int] = document["counts"]
    return {
        "kind": document["bridge"],
        "state": document["state"],
        "why": document["why"][:500],
        "version_id": document["version_id"],
        "controller": document["controller"],
        "cycle_ms": 1000.0 * document["cycle_s"],
        "cycles": counts.get("answered", 0),
        "late": counts.get("late", 0),
        "lost": counts.get("lost", 0),
        "refused": sum(document["refused"].values()),
        "offset_deg": math.degrees(max(map(abs, document["offset_rad"]))),
        "largest_offset_deg": math.degrees(document["largest_offset_rad"]),
    }


COMPANION = "kilter_client.bridges.running"
ENDS_S = 5.0
OPEN_TO_ALL = (
    "Warning: any machine on this network can take this bridge by asking first. "
    "Name the controller: --controller ADDRESS."
)


@dataclass(frozen=True)
class Bounds:
    """What a bridge holds its offsets to, and the pace of its controller."""

    largest_deg: float
    rate_deg_s: float
    ramp_s: float
    cycle_ms: float
    gone_after_s: float

    @property
    def cycle_s(self) -> float:
        """The controller's cycle."""
        return self.cycle_ms / 1000.0


@dataclass(frozen=True)
class Start:
    """What a bridge starts with."""

    robot: str
    bridge: str
    found: versions.Found
    task: Task

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.found.kinds)


def prepare_bridge(robot: str, bridge: str, version: str | None, force: bool, quiet: bool, publish: str) -> Start:
    """Check robot, controller and version at the server, and fetch the program.

    Raises:
        ConflictError: the arm would be corrected twice, or there is no version to correct with.
        UsageError: a joint is prismatic.

    """
    found = versions.fetch_startup_version(robot, version, force)
    if set(found.kinds) != {"revolute"}:
        raise UsageError(f"Robot {robot} has prismatic joints: a bridge offsets revolute ones only.")
    pinned = None if version is None else found.version_id
    return Start(robot, bridge, found, Task(robot, bridge, pinned, found.number, force, quiet, publish))


def build_correction(start: Start, bounds: Bounds, makes_up: bool = False) -> Correction:
    """Make what offsets the joints, with its kernels compiled.

    Raises:
        FileError: the program is of another release of Kilter than this one.

    """
    try:
        stored = from_bytes(start.found.program)
    except OptionError as error:
        raise FileError(f"{error} Server and bridge must be of one release.") from error
    guard = Guard(
        start.joints, math.radians(bounds.largest_deg), math.radians(bounds.rate_deg_s), bounds.ramp_s, bounds.cycle_s
    )
    return Correction(stored, start.robot, guard, bounds.cycle_s, makes_up)


def parse_axis_signs(text: str | None, joints: int, most: int) -> list[float]:
    """Read the signs of a controller's axes, one for each joint of the robot.

    Raises:
        UsageError: they are not one for each joint, or the controller has fewer axes.

    """
    if joints > most:
        raise UsageError(f"The robot has {joints} joints, and this controller offsets {most} axes at most.")
    return parse_signs(text, joints, "robot")


def _for_port(error: Exception) -> str:
    """What to do where a port cannot be had."""
    number = error.errno if isinstance(error, OSError) else None
    if number == errno.EADDRINUSE:
        return "Another program listens there, perhaps another bridge: end it, or name another --port."
    if number == errno.EACCES:
        return "Ports below 1024 are for administrators: name another --port, in the controller too."
    return "Name an address of this machine in --listen: the one that the controller sends to."


def controller_address(text: str | None) -> Address | None:
    """Return the address of ``ADDRESS`` or ``ADDRESS:PORT``, port 0 for any; None for none.

    Raises:
        UsageError: it is not one.

    """
    if text is None:
        return None
    host, _, port = text.partition(":")
    try:
        expected = str(IPv4Address(host)), int(port or 0)
    except ValueError:
        expected = "", -1
    if not 0 <= expected[1] < 1 << 16:
        raise UsageError(f"--controller {text} is not an address: give one as 192.168.1.20 or 192.168.1.20:50000.")
    return expected


def answer_over_udp(
    start: Start, wire: Wire, bounds: Bounds, listen: str, port: int, controller: str | None
) -> dict[str, Any]:
    """Answer a controller until a signal ends it; returns what happened.

    Raises:
        UsageError: the port cannot be had, or ``controller`` is not an address.

    """
    expected = controller_address(controller)
    correction = build_correction(start, bounds)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp, run_companion(start) as line:
        try:
            udp.bind((listen, port))
        except (OSError, OverflowError) as error:
            raise UsageError(f"UDP port {port} of {listen} cannot be had: {error}. {_for_port(error)}") from error
        loop = Loop(udp, wire, correction, line, bounds.cycle_s, bounds.gone_after_s, expected)
        with _ended_by_signals(loop):
            _print_listening_address(start, udp, expected)
            loop.run()
        return loop.document() | {"state": "ended", "robot": start.robot, "bridge": start.bridge}


def move_by_fci(start: Start, setpoints: Setpoints, bounds: Bounds, address: str, realtime: bool) -> dict[str, Any]:
    """Move a Franka robot along setpoints, corrected; returns what happened.

    Raises:
        MissingPackageError: pylibfranka is not installed.
        FrankaError: the robot does not answer, or it stopped the motion.

    """
    if start.joints != JOINTS:
        raise UsageError(f"Robot {start.robot} has {start.joints} joints; a Franka robot has {JOINTS}.")
    try:
        import pylibfranka
    except ImportError as error:
        raise MissingPackageError("This bridge needs pylibfranka: `pip install pylibfranka==0.21.3`.") from error
    correction = build_correction(start, bounds, makes_up=True)
    with run_companion(start) as line:
        fci = Fci(pylibfranka, address, setpoints, correction, line, realtime)
        with _ended_by_signals(fci):
            fci.run()
        return fci.document() | {"state": "ended", "robot": start.robot, "bridge": start.bridge}


def _print_listening_address(start: Start, udp: socket.socket, expected: Address | None) -> None:
    address, port = udp.getsockname()
    if expected is None and not IPv4Address(address).is_loopback:
        print(OPEN_TO_ALL, file=sys.stderr, flush=True)
    if not start.task.quiet:
        print(
            f"The {start.bridge} bridge of {start.robot} listens on UDP {address}:{port}.", file=sys.stderr, flush=True
        )


@contextmanager
def run_companion(start: Start) -> Iterator[Line]:
    """Run the companion as long as the bridge runs; what it is told with."""
    ours, theirs = pair()
    command = [sys.executable, "-m", COMPANION, str(theirs.fileno()), start.task.text()]
    with theirs:
        companion = subprocess.Popen(command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL)
    try:
        yield ours
    finally:
        ours.send(Kind.END, b"")
        ours.close()
        try:
            companion.wait(ENDS_S)
        except subprocess.TimeoutExpired:
            companion.kill()
            companion.wait()


@contextmanager
def _ended_by_signals(loop: Loop | Fci) -> Iterator[None]:
    """Fade out at the first Ctrl-C or SIGTERM, end at once at the second."""

    def leave(number: int, _: object) -> None:
        loop.leave()
        for one in signals:
            signal.signal(one, signal.default_int_handler)

    signals: Sequence[signal.Signals] = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(one, leave) for one in signals]
    try:
        yield
    finally:
        for one, handler in zip(signals, before, strict=True):
            signal.signal(one, handler)


if __name__ == "__main__":
    main()
