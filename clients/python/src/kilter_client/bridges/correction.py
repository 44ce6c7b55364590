"""Wanted joints in, offsets out: the kernels of the core, the version that is in use, and the guard behind them.

It knows nothing of models. Whatever a corrector answers, no offset leaves here beyond its largest value, or further from
the one before than a cycle allows.

Which version a bridge corrects with: what the server says of the robot, its controller and its versions.

What a bridge and its companion tell each other: packets over a pair of sockets, and nobody waits for the other.
"""

from __future__ import annotations

import json
import math
import socket
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from kilter_client.client import Kilter
from kilter_client.errors import ConflictError, KilterError, NotFoundError
from kilter_core.correct import JOINT_LIMIT, NOT_FINITE, OK, RATE_LIMIT, TOO_LARGE, Stored, Track, from_bytes, warm_up
from kilter_core.errors import OptionError

REFUSED = {
    NOT_FINITE: "NOT_FINITE",
    JOINT_LIMIT: "JOINT_LIMIT",
    TOO_LARGE: "CORRECTION_TOO_LARGE",
    RATE_LIMIT: "RATE_LIMIT",
}
ROBOT_BYTES = 48  # of a robot's name in a program


class Correction:
    """The offsets of one arm. ``off`` says why there are none; empty while it corrects.

    ``makes_up``: whoever sends the offsets takes up what changed in lost cycles smoothly, so that the time lost counts.
    """

    def __init__(self, stored: Stored, robot: str, guard: Guard, cycle_s: float, makes_up: bool = False) -> None:
        self._robot, self._guard, self._cycle_s, self._makes_up = robot, guard, cycle_s, makes_up
        self._stored = stored
        self._track = Track(stored.program, settled=True)
        self._since_s = 0.0  # since the last setpoint that was answered
        self.off = self._foreign(stored)
        self.server = ""
        self.refused: Counter[str] = Counter()
        self.last = "OK"
        self._largest_rad = 0.0
        warm_up()

    @property
    def joints(self) -> int:
        """Number of joints that are offset."""
        return len(self._guard.offset)

    @property
    def out(self) -> bool:
        """Whether nothing is offset."""
        return self._guard.out

    @property
    def offset(self) -> tuple[float, ...]:
        """The last offsets, rad."""
        return self._guard.offset

    def reset_to_zero(self) -> None:
        """Begin at zero: a controller that starts has no offsets yet."""
        self._guard.restart()
        self._track.restart(settled=True)
        self._since_s = 0.0

    def hear(self, kind: Kind, text: bytes) -> None:
        """Take over what the companion says."""
        if kind is Kind.PROGRAM:
            self._change(text)
        elif kind is Kind.OFF:
            self.off = text.decode()
        elif kind is Kind.SERVER:
            self.server = text.decode()

    def _change(self, content: bytes) -> None:
        try:
            stored = from_bytes(content)
        except OptionError as error:
            self.off = f"the active version's program cannot be used: {error}"
            return
        foreign = self._foreign(stored)
        if not foreign and self.off:
            self._track.restart(settled=True)  # the guard ramps it in
        if not foreign and self._track.program.n_joints != self.joints:  # it began with that of another arm
            self._track, self._stored = Track(stored.program, settled=True), stored
        elif not foreign and (stored.number, stored.robot) != (self._stored.number, self._stored.robot):
            self._track.change(stored.program)
            self._stored = stored
        self.off = foreign

    def _foreign(self, stored: Stored) -> str:
        named = self._robot.encode()[:ROBOT_BYTES].decode(errors="ignore")
        if stored.robot != named:
            return f"version {stored.version_id} is of robot {stored.robot}, not of {self._robot}"
        if stored.program.n_joints != self.joints:
            return f"version {stored.version_id} is for {stored.program.n_joints} joints, not {self.joints}"
        return ""

    def step(self, q: Sequence[float] | None, cycles: int = 1, taken: bool = True) -> tuple[float, ...]:
        """Return the offsets (n,) rad for wanted joints (n,) rad, ``cycles`` after the last ones; None: they are not known.

        ``taken``: the controller surely carries the last offsets out.
        """
        offset = self._compute_offset(q, cycles, taken)
        self._largest_rad = max(self._largest_rad, max(map(abs, offset)))
        return offset

    def _compute_offset(self, q: Sequence[float] | None, cycles: int, taken: bool) -> tuple[float, ...]:
        self._since_s += cycles * self._cycle_s
        passed = cycles if self._makes_up else 1
        if self.off:
            return self._guard.follow(None, passed, taken)
        if q is None:
            self._note("BAD_FRAME")
            return self._guard.follow(None, passed, taken)
        status = self._track.step(np.array(q, dtype=np.float64), 1, self._since_s)
        if status != OK:
            self._note(REFUSED.get(status, str(status)))
            if status == RATE_LIMIT:  # its past is the reason: begin anew, at the guard's pace
                self._track.restart(settled=True)
            return self._guard.follow(None, passed, taken)
        self._since_s, self.last = 0.0, "OK"
        return self._guard.follow(
            [new - old for new, old in zip(self._track.out.tolist(), q, strict=True)], passed, taken
        )

    def _note(self, status: str) -> None:
        self.last = status
        self.refused[status] += 1

    def document(self) -> dict[str, Any]:
        """What is to be said of it, JSON-able."""
        share = self._guard.share
        going = "off" if self.off else "holding back" if self.last != "OK" else "correcting"
        there = share == 1.0 if going == "correcting" else self.out  # the rate may hold offsets longer than the ramp
        state = going if there else "fading out" if going != "correcting" else "ramping in"
        return {
            "state": state,
            "why": self.off or (self.last if self.last != "OK" else ""),
            "version_id": self._stored.version_id,
            "version": f"{self._stored.number:016x}",
            "share": round(share, 4),
            "offset_rad": [round(one, 9) for one in self.offset],
            "largest_offset_rad": round(self._largest_rad, 9),
            "refused": dict(self.refused),
            "server": self.server,
        }


class Guard:
    """The offset of each joint, rad.

    Args:
        joints: how many there are.
        largest_rad: of any offset.
        rate_rad_s: how fast an offset changes at most.
        ramp_s: over which offsets come in from zero, and go out.
        cycle_s: of the controller. An offset changes by no more than that allows with each answer, however long the pause
            before it was: most controllers carry it out within one cycle.

    """

    def __init__(self, joints: int, largest_rad: float, rate_rad_s: float, ramp_s: float, cycle_s: float) -> None:
        self._largest, self._most, self._part = largest_rad, rate_rad_s * cycle_s, cycle_s / max(ramp_s, cycle_s)
        self.share = 0.0  # of the offset wanted: 0 out, 1 in
        self.offset = self._wanted = (0.0,) * joints
        self._low = self._high = self.offset  # between which the offsets are that the controller carries out

    def restart(self) -> None:
        """Begin at zero: the controller's own offsets are zero."""
        self.offset = self._wanted = self._low = self._high = (0.0,) * len(self.offset)
        self.share = 0.0

    @property
    def out(self) -> bool:
        """Whether nothing is offset."""
        return self.share == 0.0 and not any(self.offset)

    def follow(self, wanted: Sequence[float] | None, cycles: int = 1, taken: bool = True) -> tuple[float, ...]:
        """Return the next offset on the way to ``wanted``; None: the last one is to go out.

        It may change as much as ``cycles`` allow: more than one only for who takes what was lost up over several cycles.
        Where the last offset was not surely ``taken``, it is as near to those before, one of which may be in force.
        """
        if taken:
            self._low = self._high = self.offset
        if wanted is not None and all(map(math.isfinite, wanted)):
            self._wanted = tuple(wanted)
            self.share = min(1.0, self.share + cycles * self._part)
        else:
            self.share = max(0.0, self.share - cycles * self._part)
        smooth = self.share * self.share * (3.0 - 2.0 * self.share)
        # One scale for all joints. Near a stretched elbow large offsets of two joints make up for each other: one that
        # went ahead of the other would take the tool further off than no correction does.
        scale = smooth * _fitting(self._largest, self._wanted)
        steps = [scale * one - now for one, now in zip(self._wanted, self.offset, strict=True)]
        most = cycles * self._most
        rooms = [
            most - (now - low if step > 0.0 else high - now)
            for now, low, high, step in zip(self.offset, self._low, self._high, steps, strict=True)
        ]
        part = min((max(0.0, room) / abs(step) for room, step in zip(rooms, steps, strict=True) if step), default=1.0)
        self.offset = tuple(
            min(max(now + min(1.0, part) * step, -self._largest), self._largest)  # which rounding may pass
            for now, step in zip(self.offset, steps, strict=True)
        )
        self._low = tuple(map(min, self._low, self.offset))
        self._high = tuple(map(max, self._high, self.offset))
        return self.offset


def _fitting(bound: float, numbers: Sequence[float]) -> float:
    """The share, 1 at most, of these numbers at which none is beyond the bound."""
    largest = max(map(abs, numbers))
    return 1.0 if largest <= bound else bound / largest


FORM = "corrector"


Limits = tuple[float | None, float | None]  # of a joint; None where it is not stated


@dataclass(frozen=True)
class Followed:
    """The number of the version that the bridge was told last, hexadecimal; or why it was told to stop."""

    number: str
    off: str = ""


@dataclass(frozen=True)
class Found:
    """A robot as a bridge starts with it."""

    program: bytes
    version_id: str
    number: str
    kinds: tuple[str, ...]
    limits_deg: tuple[Limits, ...]


def fetch_startup_version(robot: str, version: str | None, force: bool) -> Found:
    """Return what a bridge starts with.

    Raises:
        ConflictError: the controller corrects already or nobody said whether it does, or no version can be used.
        NotFoundError: the version is of another robot.

    """
    with Kilter() as kilter:
        arm = kilter.robots.get(robot)
        speaks_against = objection(arm, force)
        if speaks_against:
            raise ConflictError(speaks_against[1], code=speaks_against[0], robot=robot)
        if version is None and arm["active_version"] is None:
            raise ConflictError(
                f"Robot {robot} has no active version: activate one with `kilter activate`, or name one with --version.",
                code="no_active_version",
                robot=robot,
            )
        found = kilter.versions.get(version or arm["active_version"], robot=robot)
        if found["robot"] != robot:
            raise NotFoundError(
                f"Version {found['id']} is of robot {found['robot']}, not of {robot}: name one of `kilter version "
                f"list {robot}`.",
                code="version_not_found",
                robot=robot,
            )
        if version is not None and found["retired_at"] is not None:
            raise ConflictError(
                f"Version {found['id']} is retired: restore it, or name another.", code="retired", robot=robot
            )
        program = kilter.versions.export(found["id"], FORM)
    kinds = tuple(joint["kind"] for joint in arm["joints"])
    limits = tuple((*(joint.get("limits_deg") or (None, None)),) for joint in arm["joints"])
    return Found(program, found["id"], _number(found), kinds, limits)


def objection(arm: dict[str, Any], force: bool) -> tuple[str, str] | None:
    """What speaks against correcting a robot, as code and sentence: its controller does so already, or may do so."""
    compensation = arm.get("controller_compensation") or "unknown"
    if force or compensation == "none":
        return None
    code = "compensation_unknown" if compensation == "unknown" else "corrected_twice"
    return code, f"{arm.get('controller_sentence', '')} With --force the bridge corrects it nonetheless.".lstrip()


def poll_server(
    robot: str, version: str | None, force: bool, known: Followed
) -> tuple[Followed, list[tuple[Kind, bytes]], str]:
    """Ask the server once: what is known then, what is new to the bridge, and what is wrong with the server, in words."""
    try:
        with Kilter() as kilter:
            return (*_news(kilter, robot, version, force, known), "")
    except NotFoundError as error:
        return (*_off(known, error.detail), "")
    except KilterError as error:
        return known, [], f"the server cannot be asked, and the version goes on: {error.detail}"


def _news(
    kilter: Kilter, robot: str, version: str | None, force: bool, known: Followed
) -> tuple[Followed, list[tuple[Kind, bytes]]]:
    arm = kilter.robots.get(robot)
    against = objection(arm, force)
    if against:
        return _off(known, against[1])
    used = version or arm["active_version"]
    if used is None:
        return _off(known, f"robot {robot} has no active version any more")
    found = kilter.versions.get(used, robot=robot)
    if version is not None and found["retired_at"] is not None:
        return _off(known, f"version {found['id']} is retired")
    if _number(found) == known.number and not known.off:
        return known, []
    return Followed(_number(found)), [(Kind.PROGRAM, kilter.versions.export(found["id"], FORM))]


def _off(known: Followed, why: str) -> tuple[Followed, list[tuple[Kind, bytes]]]:
    news = [] if known.off == why else [(Kind.OFF, why.encode())]
    return Followed(known.number, why), news


def _number(found: dict[str, Any]) -> str:
    return str(found["sha256"])[:16]


TELL_S = 0.2  # so often the state is told
ROOM = 1 << 20  # bytes; a program of many effects has a quarter of that


class Kind(bytes, Enum):
    """The first byte of a packet."""

    PROGRAM = b"P"  # to the bridge: the program of a version, as a file has it
    OFF = b"O"  # to the bridge: why nothing is to be corrected, in words
    SERVER = b"S"  # to the bridge: what became of the server, in words; empty: it is there
    STATE = b"R"  # of the bridge: its state, JSON
    END = b"E"  # of the bridge: it ends; without this it was killed


class Line:
    """One end of the pair."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self.cut = False  # the other one is gone
        self._told_s = 0.0
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, ROOM)
        end.setblocking(False)

    def send(self, kind: Kind, text: bytes) -> bool:
        """Send a packet; False where there is no room, or nobody any more."""
        try:
            self._end.send(kind.value + text)
        except (BlockingIOError, InterruptedError):
            return False
        except OSError:
            self.cut = True
            return False
        return True

    def send_state_if_due(self, state: Callable[[], Mapping[str, Any]]) -> None:
        """Send the state, if it is time to."""
        now_s = time.monotonic()
        if now_s - self._told_s >= TELL_S:
            self._told_s = now_s
            self.send(Kind.STATE, json.dumps(state()).encode())

    def receive(self) -> tuple[Kind, bytes] | None:
        """Return the next packet; None while there is none."""
        if self.cut:
            return None
        try:
            packet = self._end.recv(ROOM)
        except (BlockingIOError, InterruptedError):
            return None
        except OSError:
            packet = b""
        if not packet:
            self.cut = True
            return None
        return Kind(packet[:1]), packet[1:]

    def fileno(self) -> int:
        """For select."""
        return self._end.fileno()

    def close(self) -> None:
        """Close this end."""
        self._end.close()


def pair() -> tuple[Line, socket.socket]:
    """Return the bridge's end, and the companion's as a socket to hand over."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    return Line(ours), theirs
