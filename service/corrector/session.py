"""zenoh sessions of the corrector: explicit endpoints, no scouting, a short lease."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

import zenoh

LEASE_MS = 1000  # a hung peer is noticed within this time; the default is ten seconds
ENCODING = "application/x-kilter;v=1"


def config(listen: str | None, connect: tuple[str, ...] = (), file: Path | None = None) -> zenoh.Config:
    """Configuration of a peer, or of what ``file`` (zenoh JSON5) says; endpoints given here come on top."""
    made = zenoh.Config.from_file(str(file)) if file else zenoh.Config()
    settings: dict[str, object] = {
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        "transport/shared_memory/enabled": False,
    }
    if not file:
        settings["mode"] = "peer"
    if listen is not None:
        settings["listen/endpoints"] = [listen]
    if connect:
        settings["connect/endpoints"] = list(connect)
        settings["connect/timeout_ms"] = 0  # a peer that is not there yet is tried again in the background
    for key, value in settings.items():
        made.insert_json5(key, json.dumps(value))
    return made


def with_free_port(endpoint: str) -> str:
    """Replace port 0 of a ``tcp/host:0`` endpoint by a free one."""
    address, _, port = endpoint.rpartition(":")
    if port != "0":
        return endpoint
    host = address.partition("/")[2].strip("[]")
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.bind((host, 0))
        return f"{address}:{probe.getsockname()[1]}"


def with_port_zero(endpoint: str) -> str:
    """Same protocol and host with a port of the system's choice, for the second process."""
    return f"{endpoint.rpartition(':')[0]}:0"


def open_listening(endpoint: str, file: Path | None) -> tuple[zenoh.Session, str]:
    """Open a session that listens on ``endpoint``; with port 0 a port somebody else took meanwhile is tried again."""
    attempts = 5 if endpoint.endswith(":0") else 1
    for attempt in range(attempts):
        chosen = with_free_port(endpoint)
        try:
            return zenoh.open(config(chosen, file=file)), chosen
        except zenoh.ZError:
            if attempt == attempts - 1:
                raise
    raise AssertionError("unreachable")


def close(session: Any) -> None:
    """Close a session, which closes all it declared; its own method has no types."""
    session.close()
