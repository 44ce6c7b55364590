"""A bridge from its options to its end: what is checked before, the companion beside it, signals, and what is told after."""

from __future__ import annotations

import errno
import math
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from ipaddress import IPv4Address
from typing import Any

from kilter_client.bridges import versions
from kilter_client.bridges.companion import Task
from kilter_client.bridges.correction import Correction
from kilter_client.bridges.fci import JOINTS, Fci
from kilter_client.bridges.guard import Guard
from kilter_client.bridges.loop import Address, Loop, Wire
from kilter_client.bridges.news import Kind, Line, pair
from kilter_client.bridges.plan import Setpoints
from kilter_client.errors import FileError, MissingPackageError, UsageError
from kilter_client.verbs.inputs import parse_signs
from kilter_core.correct import from_bytes
from kilter_core.errors import OptionError

COMPANION = "kilter_client.bridges.companion"
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
