"""Where the corrector is, and how a stream reaches it."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any


class StreamError(Exception):
    """The stream cannot be opened or used so; the message says what to do."""


_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


def robot_key_prefix(site: str, robot: str, stream: str) -> str:
    """Keys of a robot begin so.

    Raises:
        StreamError: a name cannot be part of a key, so nobody would ever answer.

    """
    for what, name in (("site", site), ("robot", robot), ("stream", stream)):
        if not _NAME.fullmatch(name):
            raise StreamError(
                f"{what} {name!r} cannot be part of a stream key: use 1 to 64 letters, digits, '_', '-' or '.', "
                "starting with a letter or digit."
            )
    return f"kilter/@v1/{site}/{robot}"


def find_corrector(data: Path | None = None) -> dict[str, Any]:
    """Read the corrector file of this machine: site and endpoints.

    Raises:
        StreamError: there is none.

    """
    folder = data or Path(os.environ.get("KILTER_DATA") or Path.home() / ".kilter")
    try:
        document: dict[str, Any] = json.loads((folder / "corrector.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise StreamError(
            f"No corrector was found through {folder / 'corrector.json'}: start `kilterd serve`, set KILTER_DATA, "
            "or give endpoints."
        ) from error
    return document


def session_config(zenoh: Any, endpoints: Sequence[str], file: Path | None = None) -> Any:
    """Peer that connects to the endpoints and to nobody else, and comes back within a quarter of a second.

    ``file`` is a zenoh configuration with the certificates of this controller.
    """
    config = zenoh.Config.from_file(str(file)) if file else zenoh.Config()
    settings: dict[str, object] = {
        "listen/endpoints": [],
        "connect/endpoints": list(dict.fromkeys(endpoints)),
        "connect/timeout_ms": 0,
        "connect/retry": {"period_init_ms": 20, "period_max_ms": 250, "period_increase_factor": 2},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": 1000,
    }
    if not file:
        settings["mode"] = "peer"
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config
