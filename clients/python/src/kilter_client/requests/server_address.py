"""Where the server is and which token it takes."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import dataclass, field
from ipaddress import ip_address
from pathlib import Path
from urllib.parse import urlsplit

from kilter_client.errors import ServerUnreachableError

SERVER_FILE = "server.json"
TOKEN_FILE = "token"  # noqa: S105 (the name of a file)


@dataclass(frozen=True)
class Place:
    """A server's address, and the token to send with every request (None: send none).

    ``by_file`` says that a server on this machine told its address in its data folder; started again it may have another.
    """

    url: str
    token: str | None
    by_file: bool = field(default=False, compare=False)


def data_folder() -> Path:
    """Return the data folder of a server on this machine: KILTER_DATA, else ``~/.kilter``."""
    return Path(os.environ.get("KILTER_DATA") or Path.home() / ".kilter")


def locate(url: str | None = None, token: str | None = None) -> Place:
    """Find the server: the arguments, else KILTER_URL and KILTER_TOKEN, else the running server's own files.

    Raises:
        ServerUnreachableError: nothing says where the server is.

    """
    told = url or os.environ.get("KILTER_URL")
    found = (told or _running_server()).rstrip("/")
    secret = token or os.environ.get("KILTER_TOKEN")
    # The token file belongs to a server on this machine: it must not travel to another one.
    if secret is None and _is_this_machine(found):
        with suppress(OSError, UnicodeDecodeError):
            secret = (data_folder() / TOKEN_FILE).read_text(encoding="ascii").strip() or None
    return Place(found, secret, by_file=not told)


def _running_server() -> str:
    file = data_folder() / SERVER_FILE
    try:
        url = json.loads(file.read_text(encoding="utf-8"))["url"]
    except FileNotFoundError as error:
        raise ServerUnreachableError(
            f"No server is known: {file} does not exist. Start one with `kilterd serve`, or set KILTER_URL.",
            file=str(file),
        ) from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ServerUnreachableError(
            f"{file} cannot be read as a server's address ({error}). Restart `kilterd serve`, or set KILTER_URL.",
            file=str(file),
        ) from error
    return str(url)


def _is_this_machine(url: str) -> bool:
    host = urlsplit(url).hostname or ""
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False
