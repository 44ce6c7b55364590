"""Sockets that a robot's library opened: strangers are kept out of them by the system.

libfranka takes whatever comes for a state of the robot: it ends the motion where the size is wrong, and answers whoever
sent it.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import stat
from collections.abc import Iterator
from pathlib import Path

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
