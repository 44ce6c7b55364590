"""zenoh sessions of the corrector: explicit endpoints, no scouting, a short lease."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zenoh

from kilter_service.stream.corrector.endpoints import cannot_listen

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
