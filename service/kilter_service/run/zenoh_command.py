"""`kilterd zenoh-config`: writes or rotates the folders of all roles."""

from __future__ import annotations

import argparse
import json
import re
import socket
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings

if TYPE_CHECKING:
    from kilter_service.run.zenoh_folders import Issued

EXAMPLE = "kilterd zenoh-config --out /etc/kilter/zenoh --host cell7.lab --controller left=arm1,arm2"
RECORD = "roles.json"


def add_options(command: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    command.add_argument("--out", type=Path, help="folder to write (default: zenoh in the data folder)")
    command.add_argument(
        "--host",
        dest="hosts",
        metavar="HOST",
        action="append",
        default=[],
        help="name or address of the corrector's machine",
    )
    command.add_argument("--listen-port", type=int, default=7447, help="port of the corrector (default 7447)")
    command.add_argument(
        "--controller",
        action="append",
        default=[],
        metavar="NAME[=ROBOT,...]",
        help="a controller, and its robots only",
    )
    command.add_argument("--rotate", action="store_true", help="make a new authority and new certificates")
    command.add_argument("--certificate", type=Path, help="certificate of the corrector from elsewhere, with its chain")
    command.add_argument("--key", type=Path, help="its private key")
    command.add_argument("--authorities", type=Path, help="certificates of the authorities that signed it")


def run(settings: Settings, given: argparse.Namespace) -> None:
    """Write zenoh configurations with TLS and access control, one folder per role, or rotate their certificates."""
    from kilter_service.run.zenoh_folders import load_or_make_authority, write_folders

    folder: Path = given.out or settings.data / "zenoh"
    roles = _roles(folder, given)
    authority, trusted = load_or_make_authority(folder, given.rotate)
    if given.authorities:
        trusted += given.authorities.read_bytes()
    written = write_folders(
        folder,
        settings.site,
        tuple(roles["hosts"]),
        roles["port"],
        {name: tuple(robots) for name, robots in roles["controllers"].items()},
        settings.ros2_domain,
        authority,
        trusted,
        _issued_from_arguments(given),
    )
    (folder / RECORD).write_text(json.dumps(roles, indent=1), encoding="utf-8")
    print(f"Copy each folder to its machine, and nothing of {folder / 'authority'}:")
    for place in written:
        print(f"  {place}")
    print(
        f"Then start the corrector with KILTER_ZENOH_CONFIG={folder / 'corrector' / 'zenoh.json5'} "
        f"KILTER_ZENOH_LISTEN=tls/0.0.0.0:{roles['port']}"
    )


def _roles(folder: Path, given: argparse.Namespace) -> dict[str, Any]:
    """What the options say, else what was written last time."""
    if given.hosts or given.controller or not (folder / RECORD).exists():
        controllers = dict(map(_controller, given.controller or ["main"]))
        hosts = given.hosts or [socket.gethostname(), "localhost", "127.0.0.1"]
        return {"hosts": hosts, "port": given.listen_port, "controllers": controllers}
    roles: dict[str, Any] = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    return roles


def _controller(text: str) -> tuple[str, list[str]]:
    name, _, robots = text.partition("=")
    names = [name, *(robots.split(",") if robots else [])]
    for one in names:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", one):
            raise ServiceError(
                f"--controller {text}: {one!r} is not a name; use 1 to 64 letters, digits, '_', '-' or '.', as in "
                "left=arm1,arm2.",
                code="option_invalid",
            )
    return name, names[1:] or ["*"]


def _issued_from_arguments(given: argparse.Namespace) -> Issued | None:
    from kilter_service.run.zenoh_folders import Issued

    files = (given.certificate, given.key, given.authorities)
    if not any(files):
        return None
    if not all(files):
        raise ServiceError("--certificate, --key and --authorities go together.", code="option_invalid")
    return Issued(given.certificate.read_bytes(), given.key.read_bytes())
