"""What a bridge and its companion tell each other: packets over a pair of sockets, and nobody waits for the other."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any

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
