"""Franka Control Interface: joint positions at 1 kHz through libfranka. The bridge plays a table, corrected."""

from __future__ import annotations

import contextlib
import math
import os
import select
import socket
import stat
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from operator import add
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.bridges.correction import Line
from kilter_client.bridges.loop import without_collections
from kilter_client.bridges.plan import Setpoints, smooth
from kilter_client.errors import KilterError

if TYPE_CHECKING:
    from kilter_client.bridges.correction import Correction

# Sockets that a robot's library opened: strangers are kept out of them by the system.
#
# libfranka takes whatever comes for a state of the robot: it ends the motion where the size is wrong, and answers
# whoever sent it.

DESCRIPTORS = Path("/proc/self/fd")  # of Linux, as libfranka is
FIRST_S = 1.0  # within which a robot's first packet comes
MOST_WAITING = 10_000


@contextlib.contextmanager
def opened_sockets_hear(address: str) -> Iterator[None]:
    """Let UDP sockets that are opened within the context receive from the robot at ``address`` alone afterwards."""
    before = _udp_sockets()
    yield
    for number in _udp_sockets() - before:
        with socket.socket(fileno=os.dup(number)) as one:
            _connect_to_sender(one, socket.gethostbyname(address))


def _udp_sockets() -> set[int]:
    """File descriptors of this process that are UDP sockets."""
    found = set()
    for name in os.listdir(DESCRIPTORS) if DESCRIPTORS.exists() else ():
        with contextlib.suppress(OSError):  # that of the listing itself is closed by now
            if stat.S_ISSOCK(os.fstat(int(name)).st_mode):
                with socket.socket(fileno=os.dup(int(name))) as one:
                    if (one.family, one.type) == (socket.AF_INET, socket.SOCK_DGRAM):
                        found.add(int(name))
    return found


def _connect_to_sender(one: socket.socket, address: str) -> None:
    """Connect a socket to the port from which the robot sends, and drop what waits: the next state comes in a millisecond."""
    waiting = select.poll()
    waiting.register(one, select.POLLIN)
    for _ in range(MOST_WAITING):
        if not waiting.poll(1000 * FIRST_S):
            return
        sender = one.recvfrom(1, socket.MSG_DONTWAIT)[1]
        if sender[0] == address:
            one.connect(sender)
            break
    with contextlib.suppress(BlockingIOError):
        for _ in range(MOST_WAITING):
            one.recv(1, socket.MSG_DONTWAIT)


CYCLE_S = 0.001
JOINTS = 7
REJOIN_S = 0.04  # at least, and longer after pauses, or where the way back would take more than this of the limits
MOST_RAD_S2, MOST_RAD_S3 = 3.0, 1500.0  # of 10 and 5000, an FR3's
FORGETS = 0.98  # by each command, how long the last pauses were
Joints = tuple[float, ...]
# A command that needed longer than this may come after its cycle: what is left is for the network and for whatever holds the
# process up before it is out. The robot drops it; a simulator was seen to go back for it and to take the mean speed since for
# the robot's: it is better not sent, whoever listens.
LATE_S, LATEST_S = 0.0005, 0.0009
MANY_UNANSWERED = 10  # cycles, after which LATEST_S counts and not LATE_S: the robot stops at 20
WAITED_S = 0.0001  # a state that came at once may have waited in the socket
# A state that was waited for, but came by so many cycles later than the robot's clock says, may have waited for the process
# to be woken, its cycle over. No command goes out until a state was waited for again and came in time, or that many went by.
HELD_CYCLES, MOST_UNANSWERED = 1, 5
BRAKE_S = 1.0  # in which the plan is brought to rest when the bridge is ended


class FrankaError(KilterError):
    """The robot does not answer, or it stopped the motion."""

    default_code = "robot_stopped"
    default_title = "Robot stopped"


class Rejoined:
    """Commands that go on smoothly where cycles were lost.

    The robot extrapolates what it misses with constant acceleration. From the position, speed and acceleration it then has,
    a polynomial of the fifth degree takes the command back to what is intended, slowly enough for the limits of the
    interface. It is planned anew until three intended setpoints in a row are known, so that speed and acceleration of what is
    intended are, and whenever a cycle is lost again: the command never runs away, however many are. Without losses
    the command is what was intended.
    """

    def __init__(self) -> None:
        self._times_s: deque[float] = deque(maxlen=3)
        self._intended: deque[Joints] = deque(maxlen=3)
        # What the robot was off, and the first two derivatives of that, where the way back began.
        self._off: tuple[Joints, Joints, Joints] = ((), (), ())
        self._over_s = self._since_s = 0.0  # how long the way back takes, and how long it has taken
        self._fresh = 0  # cycles for which it is planned anew
        self._pause = 1.0  # cycles that may go by until the next command, by those that lately did
        self._unsent = self._gone = 0  # cycles since the last command that was sent, and as many before this one

    def command(self, intended: Joints, cycles: int, state: Any) -> Joints:
        """Return the joints (n,) rad to send for those intended, ``cycles`` after the last ones."""
        now_s = (self._times_s[-1] if self._times_s else 0.0) + cycles * CYCLE_S
        self._times_s.append(now_s)
        self._intended.append(intended)
        self._gone, self._unsent = self._unsent + cycles, 0
        if self._gone > 1:
            self._fresh = 3
        if len(self._intended) < 3:
            return _onwards(state, state.ddq_d) if self._fresh else intended
        self._pause = max(float(self._gone), FORGETS * self._pause)
        self._since_s += cycles * CYCLE_S
        if self._fresh:
            self._fresh -= 1
            self._plan(state)
            if self._fresh:
                return self._first_step(state)
        if self._since_s >= self._over_s:
            return intended
        return tuple(map(add, intended, self._remaining_offset()))

    def unsent(self) -> None:
        """Take back the last command: it was not sent, and the robot extrapolates."""
        self._unsent = self._gone

    @property
    def gone(self) -> int:
        """Cycles since the last command that was sent, this one included."""
        return max(1, self._gone)

    @property
    def back(self) -> bool:
        """Whether the robot is where it is intended to be."""
        return not self._fresh and self._since_s >= self._over_s

    def _motion(self) -> tuple[Joints, Joints]:
        """Speed and acceleration of what is intended, by the parabola through the last three setpoints."""
        t0, t1, t2 = self._times_s
        first, second = t1 - t0, t2 - t1
        speeds, curves = [], []
        for q0, q1, q2 in zip(*self._intended, strict=True):
            before, last = (q1 - q0) / first, (q2 - q1) / second
            curve = 2.0 * (last - before) / (t2 - t0)
            speeds.append(last + 0.5 * curve * second)
            curves.append(curve)
        return tuple(speeds), tuple(curves)

    def _plan(self, state: Any) -> None:
        """Begin the way back one cycle ago, where the robot was told to be, as it moves there."""
        speeds, curves = self._motion()
        place = [
            q - (aim - CYCLE_S * (speed - 0.5 * CYCLE_S * curve))
            for q, aim, speed, curve in zip(state.q_d, self._intended[-1], speeds, curves, strict=True)
        ]
        # The robot's speed is that of the last cycle on average: half a cycle before where it is.
        speed = [
            dq + 0.5 * CYCLE_S * ddq - (v - CYCLE_S * a)
            for dq, ddq, v, a in zip(state.dq_d, state.ddq_d, speeds, curves, strict=True)
        ]
        curve = [ddq - a for ddq, a in zip(state.ddq_d, curves, strict=True)]
        self._off, self._since_s = (tuple(place), tuple(speed), tuple(curve)), CYCLE_S
        d, w, a = (max(map(abs, one)) for one in (place, speed, curve))
        self._over_s = max(
            REJOIN_S,
            10.0 * self._ahead_s,
            math.sqrt(2.0 * 5.78 * d / MOST_RAD_S2),
            2.0 * 4.0 * w / MOST_RAD_S2,
            (180.0 * d / MOST_RAD_S3) ** (1.0 / 3.0),
            math.sqrt(108.0 * w / MOST_RAD_S3),
            27.0 * a / MOST_RAD_S3,
        )

    def _first_step(self, state: Any) -> Joints:
        """One cycle further along the way back, by its acceleration: planned anew each time, by its place alone it would
        change the robot's acceleration by a sixth of what it should, and swing.

        The robot may keep that acceleration for as many cycles as it has missed lately: it is that of their middle.
        """
        T, ahead_s = self._over_s, self._ahead_s
        curves = [
            aim + a - ahead_s * (60.0 * d / T**3 + 36.0 * w / T**2 + 9.0 * a / T)
            for aim, d, w, a in zip(self._motion()[1], *self._off, strict=True)
        ]
        return _onwards(state, curves)

    @property
    def _ahead_s(self) -> float:
        """The middle of the time for which the robot may keep an acceleration, by the cycles that it missed lately."""
        return 0.5 * CYCLE_S * (1.0 + self._pause)

    def _remaining_offset(self) -> Joints:
        """What is left of the way back now: from the start with all its derivatives to zero with all of them."""
        T, u = self._over_s, self._since_s / self._over_s
        of_place = 1.0 - smooth(u)
        of_speed = T * (u + u**3 * (-6.0 + u * (8.0 - 3.0 * u)))
        of_curve = 0.5 * T * T * u * u * (1.0 + u * (-3.0 + u * (3.0 - u)))
        return tuple(of_place * d + of_speed * w + of_curve * a for d, w, a in zip(*self._off, strict=True))


def _onwards(state: Any, curves: Iterable[float]) -> Joints:
    """Where the robot is a cycle later at an acceleration (n,) rad/s2; at its own it goes there by itself."""
    return tuple(
        q + CYCLE_S * (dq + CYCLE_S * curve) for q, dq, curve in zip(state.q_d, state.dq_d, curves, strict=True)
    )


class Fci:
    """One motion of one robot: from where it stands along the plan, and to rest.

    Args:
        franka: the module ``pylibfranka``.
        address: of the robot.
        setpoints: what is played; its cycle is that of the interface.
        correction: what offsets the joints.
        line: to the companion.
        realtime: refuse to run without a real-time kernel and priority, as libfranka does by itself.
        clock: seconds, by which a command is late.

    """

    def __init__(
        self,
        franka: Any,
        address: str,
        setpoints: Setpoints,
        correction: Correction,
        line: Line,
        realtime: bool,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._clock, self._opened_s = clock, math.inf  # when the last state went out
        self._read_s, self._out_of_step = math.inf, 0  # when it was read; for how many more states no command goes out
        self._franka, self._address, self._realtime = franka, address, realtime
        self._setpoints, self._correction, self._line = setpoints, correction, line
        self._pace, self._leaving = 1.0, False
        self._success: float | None = None
        self._rejoined = Rejoined()
        self.counts: Counter[str] = Counter()

    def leave(self) -> None:
        """Bring the plan to rest and fade the offsets out, then end."""
        self._leaving = True

    def run(self) -> None:
        """Move to the end of the plan, or until :meth:`leave`.

        Raises:
            FrankaError: the robot does not answer, or it stopped the motion.

        """
        realtime = self._franka.RealtimeConfig.kEnforce if self._realtime else self._franka.RealtimeConfig.kIgnore
        try:
            with without_collections():
                with opened_sockets_hear(self._address):
                    robot = self._franka.Robot(self._address, realtime)
                control = robot.start_joint_position_control(self._franka.ControllerMode.JointImpedance)
                while not self._cycle(control):
                    pass
        except (self._franka.FrankaException, RuntimeError) as error:  # most of its exceptions are only the latter
            raise FrankaError(f"The robot at {self._address} stopped: {error}") from error

    def _cycle(self, control: Any) -> bool:
        """One cycle; whether the motion is over."""
        asked_s = self._clock()
        state, passed = control.readOnce()
        cycles = max(1, round(passed.to_sec() / CYCLE_S)) if self.counts["answered"] else 1
        self._note_opened(asked_s, cycles)
        self.counts["lost"] += cycles - 1
        if not self.counts["answered"]:
            self._start_from_commanded(state)
        wanted = self._setpoints.step(cycles, self._pace) or tuple(state.q_d)
        offset = self._correction.step(wanted, cycles)
        intended = tuple(q + one for q, one in zip(wanted, offset, strict=True))
        self._success = float(state.control_command_success_rate)
        command = self._franka.JointPositions(list(self._rejoined.command(intended, cycles, state)))
        at_rest = self._setpoints.is_finished or self._pace == 0.0
        if at_rest:
            self._correction.off = "the motion is over"
        command.motion_finished = over = at_rest and self._correction.out and self._rejoined.back
        sent = not self._out_of_step and self._clock() - self._opened_s < self._late_s
        if sent:
            control.writeOnce(command)
            self.counts["answered"] += 1
        else:
            self._rejoined.unsent()
            self.counts["late"] += 1
        if self._leaving:
            self._pace = max(0.0, self._pace - cycles * CYCLE_S / BRAKE_S)
        while (packet := self._line.receive()) is not None:
            self._correction.hear(*packet)
        self._line.send_state_if_due(self.document)
        return bool(over and sent)

    @property
    def _late_s(self) -> float:
        """How long after its state a command may go out: the longer none did, the more a late one is worth.

        A machine that was held up for 13 ms was seen to compute several times slower for as many cycles again.
        """
        unanswered = min(1.0, (self._rejoined.gone - 1) / MANY_UNANSWERED)
        return LATE_S + unanswered * (LATEST_S - LATE_S)

    def _note_opened(self, asked_s: float, cycles: int) -> None:
        """Note when the state went out that was just read: now, if it was waited for, else by the time of the last one."""
        now_s, due_s = self._clock(), self._opened_s + cycles * CYCLE_S
        waited = now_s - asked_s > WAITED_S
        self._opened_s = now_s if waited else min(now_s, due_s)
        if now_s - self._read_s > (cycles + HELD_CYCLES) * CYCLE_S:
            self._out_of_step = MOST_UNANSWERED
        elif self._out_of_step:
            self._out_of_step = 0 if waited else self._out_of_step - 1
        self._read_s = now_s

    def _start_from_commanded(self, state: Any) -> None:
        """Stand where the robot is told to stand already."""
        self._correction.reset_to_zero()
        self._setpoints.start_from_joints(state.q_d)

    def document(self) -> dict[str, Any]:
        """The state, JSON-able."""
        return self._correction.document() | {
            "controller": self._address,
            "counts": dict(self.counts + self._setpoints.counts),
            "controller_missed": None,
            "command_success_rate": self._success,
            "cycle_s": CYCLE_S,
        }
