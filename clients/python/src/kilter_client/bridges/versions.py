"""Which version a bridge corrects with: what the server says of the robot, its controller and its versions.

What a bridge and its companion tell each other: packets over a pair of sockets, and nobody waits for the other.
"""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

from kilter_client.client import Kilter
from kilter_client.errors import ConflictError, KilterError, NotFoundError

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
