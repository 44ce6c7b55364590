"""zenoh sessions of the corrector: explicit endpoints, no scouting, a short lease.

What the processes of the corrector get when they are spawned, and where each of them begins.

Light on purpose: the supervisor of both starts them before it imports anything heavy itself.

How a stream process outlives the corrector that started it, and how the next corrector takes it over.

An arm that moves is corrected by the stream process alone. So it does not end with its corrector when that is killed, or
with the whole server above it: it goes on with the versions in use and opens its door, a socket in the private folder of
the corrector. Whoever starts next for the same data folder finds the door through the corrector file.
"""

from __future__ import annotations

import importlib
import json
import os
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import zenoh

from kilter_service.contract.streams import MAX_AGE_NS
from kilter_service.ground.private_files import hold_scratch_folder
from kilter_service.ground.settings import code_version
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.endpoints import cannot_listen, orphan_door_path
from kilter_service.stream.signing.masters import Masters

LEASE_MS = 1000  # a hung peer is noticed within this time; the default is ten seconds
RETRY = {"period_init_ms": 50, "period_max_ms": 250, "period_increase_factor": 2}
ENCODING = "application/x-kilter;v=1"


def config(
    listen: str | None, connect: tuple[str, ...] = (), file: Path | None = None, private: str | None = None
) -> zenoh.Config:
    """Configuration of a peer, or of what ``file`` (zenoh JSON5) says; endpoints given here come on top.

    Without ``listen`` and ``private`` it listens nowhere; left to itself zenoh would, on every address.
    """
    made = zenoh.Config.from_file(str(file)) if file else zenoh.Config()
    settings: dict[str, object] = {
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        "transport/shared_memory/enabled": False,
        "listen/endpoints": [endpoint for endpoint in (listen, private) if endpoint is not None],
    }
    if not file:
        settings["mode"] = "peer"
    if connect:
        settings["connect/endpoints"] = list(dict.fromkeys(connect))
        settings["connect/timeout_ms"] = 0  # a peer that is not there yet is tried again in the background
    for key, value in settings.items():
        made.insert_json5(key, json.dumps(value))
    return made


def is_client(file: Path | None) -> bool:
    """Whether a configuration makes its session a client of a router: then nobody else can meet it."""
    return file is not None and bool(json.loads(zenoh.Config.from_file(str(file)).get_json("mode")) == "client")


def with_free_port(endpoint: str) -> str:
    """Replace port 0 of a ``tcp/host:0`` endpoint by a free one."""
    address, _, port = endpoint.rpartition(":")
    if port != "0":
        return endpoint
    host = address.partition("/")[2].strip("[]")
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.bind((host, 0))
        return f"{address}:{probe.getsockname()[1]}"


def open_listening(
    endpoint: str, file: Path | None, private: str | None = None, again: str | None = None
) -> tuple[zenoh.Session, str]:
    """Open a session that listens on ``endpoint``; with port 0 first where it was before (``again``), then on a free one.

    Raises:
        ServiceError: the system does not allow it, or the port is taken.

    """
    attempts = 5 if endpoint.endswith(":0") else 1
    for attempt in range(attempts):
        kept = again if attempt == 0 and again is not None and _same_but_port(endpoint, again) else None
        chosen = kept or with_free_port(endpoint)
        try:
            return zenoh.open(config(chosen, file=file, private=None if is_client(file) else private)), chosen
        except zenoh.ZError as error:
            if attempt == attempts - 1:
                raise cannot_listen(endpoint, str(error)) from error
    raise AssertionError("unreachable")


def _same_but_port(endpoint: str, other: str) -> bool:
    return endpoint.endswith(":0") and endpoint.rpartition(":")[0] == other.rpartition(":")[0]


def open_inside(private: str, file: Path | None, stopped: Callable[[float], bool]) -> zenoh.Session | None:
    """Open a session that listens nowhere and is reached through ``private``, or through the router of ``file``.

    None when ``stopped(seconds)`` says so before the other side is there.
    """
    made = config(None, () if is_client(file) else (private,), file)
    made.insert_json5("mode", '"client"')  # a peer passes queries on to its clients, not to other peers
    made.insert_json5("connect/retry", json.dumps(RETRY))
    while True:
        try:
            return zenoh.open(made)
        except zenoh.ZError:
            if stopped(0.05):
                return None


def close(session: Any) -> None:
    """Close a session, which closes all it declared; its own method has no types."""
    session.close()


STREAM, QUERY = "kilter_service.stream.corrector.loop:stream_main", "kilter_service.stream.corrector.queries:query_main"


@dataclass(frozen=True)
class Rules:
    """Bounds that do not belong to a version.

    Clocks of two machines are never compared. The smallest difference between arrival and sending seen so far counts
    as the transit time; the age of a frame is what exceeds that. ``clock_drift`` lets that smallest difference grow again.
    It grows at once when a clock is set back by more than ``set_back_ns``, or when late frames agree within
    ``agree_ns`` on a longer transit time for ``agree_for_ns``. Of ``slots`` streams, one that was good within
    ``idle_ns`` keeps its own.
    """

    max_age_ns: int = MAX_AGE_NS
    clock_drift: float = 200e-6
    set_back_ns: int = 5_000_000
    agree_ns: int = 5_000_000
    agree_for_ns: int = 100_000_000
    recent_ns: int = 1_000_000_000
    time_slack_s: float = 0.1
    ring: int = 256
    slots: int = 256
    idle_ns: int = 10_000_000_000


@dataclass(frozen=True)
class StreamSpec:
    """What the stream process gets when it is spawned; at ``private_endpoint`` it meets the query process.

    ``again`` is where the one before it listened: where the port is left open (0), clients look there first.
    """

    site: str
    instance: str
    listen: str
    private_endpoint: str
    masters: Masters
    unsigned: bool
    zenoh_config: Path | None = None
    rules: Rules = field(default_factory=Rules)
    keys_file: Path | None = None
    again: str | None = None

    def serves_as(self, other: StreamSpec) -> bool:
        """Whether a stream process that was started with ``other`` does what one started with this would."""
        theirs = ("instance", "private_endpoint", "masters", "again")
        return replace(self, **{name: getattr(other, name) for name in theirs}) == other


@dataclass(frozen=True)
class QuerySpec:
    """What the query process gets when it is spawned."""

    site: str
    private_endpoint: str
    masters: Masters
    unsigned: bool
    zenoh_config: Path | None = None


def enter(entry: str, spec: StreamSpec | QuerySpec, pipe: Connection) -> None:
    """Run ``entry`` ("module:function") in the spawned process, which imports it; its parent did not have to."""
    module, _, function = entry.partition(":")
    getattr(importlib.import_module(module), function)(spec, pipe)


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
