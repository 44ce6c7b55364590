"""How a stream process outlives the corrector that started it, and how the next corrector takes it over.

An arm that moves is corrected by the stream process alone. So it does not end with its corrector when that is killed, or
with the whole server above it: it goes on with the versions in use and opens its door, a socket in the private folder of
the corrector. Whoever starts next for the same data folder finds the door through the corrector file.
"""

from __future__ import annotations

import json
import os
import socket
from contextlib import suppress
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from kilter_service.ground.files.private_files import hold_scratch_folder
from kilter_service.ground.version import code_version
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.endpoints import orphan_door_path
from kilter_service.stream.corrector.session import StreamSpec

ORPHAN_S = 60.0  # longer than a server takes to start; an arm should not follow for long what nobody can change
ANSWER_S = 3.0  # in which both sides answer, which takes milliseconds
TAKE, STOP = "take", "stop"


class State(NamedTuple):
    """What a stream process tells the corrector that takes it over."""

    pid: int
    spec: StreamSpec
    endpoint: str
    active: dict[str, Active]


class Found(NamedTuple):
    """A stream process that went on alone, and the pipe to it."""

    pipe: Connection
    pid: int
    spec: StreamSpec
    endpoint: str
    active: dict[str, Active]


class Door:
    """Through which another corrector comes to a stream process."""

    def __init__(self, private: str) -> None:
        place = orphan_door_path(private)
        self._folder = hold_scratch_folder(place.parent)  # it would be removed with the process that made it
        self._last: Connection | None = None
        self.socket = socket.socket(socket.AF_UNIX)
        with suppress(FileNotFoundError):  # of one that was killed
            place.unlink()
        self.socket.bind(str(place))
        self.socket.listen()

    def __enter__(self) -> Door:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _: TracebackType | None
    ) -> None:
        self.socket.close()
        if self._folder is not None:
            self._folder.close()

    def handle_connection(self, state: State) -> tuple[bool, Connection | None]:
        """Answer whoever came; returns whether to go on, and the pipe of the corrector that takes over, if it does."""
        try:
            pipe = self._last = Connection(self.socket.accept()[0].detach())
            pipe.send(code_version())  # in words that every release reads
            if not pipe.poll(ANSWER_S):
                return True, None
            said = pipe.recv()
            if said == STOP:
                return False, None  # the end of this process ends the pipe, which tells the other
            pipe.send(state)
            for number in (1, 2):  # what is said here goes where the other says its own
                theirs = recv_handle(pipe)
                os.dup2(theirs, number)
                os.close(theirs)
        except (EOFError, OSError):  # it only looked, or was killed
            return True, None
        return True, pipe


def goes_on_alone(file: Path) -> bool:
    """Whether a stream process waits for a corrector, or will when its own has ended: then it holds the endpoint."""
    pipe = _knock(file)
    if pipe is None:
        return False
    pipe.close()
    return True


def take_over(file: Path, wanted: StreamSpec) -> Found | None:
    """Take over the stream process that the corrector file names, if it does what is wanted; end it if it does not."""
    pipe = _knock(file)
    if pipe is None:
        return None
    with suppress(EOFError, OSError):
        if not pipe.poll(ANSWER_S):  # its own corrector runs
            pipe.close()
            return None
        if pipe.recv() == code_version():
            pipe.send(TAKE)
            state: State = pipe.recv()
            for number in (1, 2):
                send_handle(pipe, number, state.pid)
            if state.spec.serves_as(wanted):
                return Found(pipe, *state)
            pipe.send((STOP,))
        else:
            pipe.send(STOP)
        pipe.poll(ANSWER_S)  # until it is gone, for it holds the endpoint
    pipe.close()
    return None


def _knock(file: Path) -> Connection | None:
    made = socket.socket(socket.AF_UNIX)
    try:
        made.connect(str(orphan_door_path(json.loads(file.read_text(encoding="utf-8"))["private"])))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        made.close()
        return None
    return Connection(made.detach())
