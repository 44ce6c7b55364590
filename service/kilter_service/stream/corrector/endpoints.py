"""Endpoints and key expressions of the stream; without zenoh, so that a start can check them early.

``@v1`` is a verbatim chunk: no wildcard matches it, so a peer of another version never sees these messages.
"""

from __future__ import annotations

import errno
import ipaddress
import re
import socket
from dataclasses import dataclass
from pathlib import Path

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.private_files import Scratch, scratch_for_sockets
from kilter_service.ground.settings import Settings

ON_THIS_MACHINE = ("unixsock-stream", "unixpipe")


def is_local(endpoint: str) -> bool:
    """Whether an endpoint (``tcp/127.0.0.1:7447``) can be reached from this machine only."""
    protocol, _, address = endpoint.partition("/")
    if protocol in ON_THIS_MACHINE:
        return True
    host = address.partition("#")[0].partition("?")[0].rpartition(":")[0].strip("[]")
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def check_listening(settings: Settings) -> None:
    """Refuse to listen beyond this machine when nobody has said who may connect.

    Raises:
        ServiceError: the endpoint is not on loopback and there is no zenoh configuration.

    """
    if settings.zenoh_config is not None or is_local(settings.zenoh_listen):
        return
    raise ServiceError(
        f"{settings.zenoh_listen} can be reached from other machines, and whoever reaches it can move the arm: set "
        "KILTER_ZENOH_CONFIG to a zenoh configuration with TLS and access control, or KILTER_ZENOH_LISTEN to "
        "tcp/127.0.0.1:7447.",
        code="binding_refused",
        listen=settings.zenoh_listen,
    )


def check_ros2(settings: Settings) -> None:
    """Refuse a router of ROS beyond this machine without TLS: its messages have no room for a signature.

    Raises:
        ServiceError: the router is elsewhere, and the way to it is not TLS with a zenoh configuration.

    """
    endpoint = settings.ros2_connect
    if is_local(endpoint) or (settings.ros2_zenoh_config is not None and endpoint.startswith(("tls/", "quic/"))):
        return
    raise ServiceError(
        f"Messages of ROS 2 are not signed, so they go to {endpoint} only behind TLS and access control: set "
        "KILTER_ROS2_ZENOH_CONFIG to the zenoh.json5 of the folder `ros` that `kilterd zenoh-config` writes, and "
        "KILTER_ROS2_CONNECT to a tls/ endpoint, or run the adaptor on the machine of the router.",
        code="binding_refused",
        connect=endpoint,
    )


def cannot_listen(endpoint: str, reason: str) -> ServiceError:
    """What to say when an endpoint is refused by the system."""
    why = "another program listens there" if "Address already in use" in reason else reason.partition(" at /")[0]
    return ServiceError(
        f"The corrector cannot listen on {endpoint}, {why}: set KILTER_ZENOH_LISTEN to another endpoint, for example "
        "tcp/127.0.0.1:7448 (port 0 takes a free one).",
        code="binding_refused",
        listen=endpoint,
    )


def check_free(endpoint: str) -> None:
    """Refuse a TCP endpoint that another program listens on, before a process is started for it.

    Raises:
        ServiceError: it is taken.

    """
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.partition("#")[0].partition("?")[0].rpartition(":")
    if protocol != "tcp" or not port.isdecimal() or port == "0":
        return
    family = socket.AF_INET6 if host.startswith("[") else socket.AF_INET
    try:
        with socket.socket(family) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # a closed connection does not occupy the port
            probe.bind((host.strip("[]"), int(port)))
    except OSError as error:
        if error.errno == errno.EADDRINUSE:  # zenoh reports all other errors
            raise cannot_listen(endpoint, "Address already in use") from error


UNIX = "unixsock-stream/"


def orphan_door_path(private: str) -> Path:
    """Where another corrector finds a stream process whose own is gone: beside the socket of the query process."""
    return socket_folder(private) / "door"


def socket_folder(private: str) -> Path:
    """Private folder of a corrector, by the endpoint in it."""
    return Path(private.removeprefix(UNIX)).parent


class PrivateSocket:
    """Where the query process meets the stream process: a socket in a folder that nobody else may enter.

    So the corrector has one port, and queries come through it; still, the other process does their work.
    """

    def __init__(self, data: Path, endpoint: str | None = None) -> None:
        """Make it, or share the one at ``endpoint``, where a stream process is that another corrector started."""
        self._scratch = (
            scratch_for_sockets(data) if endpoint is None else Scratch.from_shared_folder(socket_folder(endpoint))
        )
        self.endpoint = endpoint or f"{UNIX}{self._scratch.folder / 'socket'}"

    def leave(self) -> None:
        """Leave it to the stream process, which goes on."""
        self._scratch.leave()

    def close(self) -> None:
        """Remove the folder."""
        self._scratch.close()


PREFIX = "kilter/@v1"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


def validate_chunk(name: str, what: str) -> str:
    """Return ``name`` when it can be one chunk of a key, else raise ValueError naming the rule."""
    if not _NAME.fullmatch(name):
        raise ValueError(
            f"{what} {name!r} cannot be part of a stream key: use 1 to 64 letters, digits, '_', '-' or '.', "
            "starting with a letter or digit."
        )
    return name


@dataclass(frozen=True)
class RobotKeys:
    """Keys of one robot at one site."""

    site: str
    robot: str

    def __post_init__(self) -> None:
        validate_chunk(self.site, "site")
        validate_chunk(self.robot, "robot")

    @property
    def root(self) -> str:
        """Prefix of all keys of the robot."""
        return f"{PREFIX}/{self.site}/{self.robot}"

    @property
    def active(self) -> str:
        """Where the version in use is announced, on change and on request."""
        return f"{self.root}/active"

    @property
    def correct(self) -> str:
        """Query: a whole trajectory."""
        return f"{self.root}/@rpc/correct"

    @property
    def describe(self) -> str:
        """Query: what the stream expects and does."""
        return f"{self.root}/@rpc/describe"

    def alive(self, instance: str) -> str:
        """Liveliness token of the corrector process ``instance`` for this robot."""
        return f"{self.root}/@alive/{validate_chunk(instance, 'instance')}"

    def stream(self, stream: str, part: str) -> str:
        """Key of one part (``in``, ``out``, ``status`` or ``live``) of a stream."""
        return f"{self.root}/stream/{validate_chunk(stream, 'stream')}/{part}"


def every_input(site: str) -> str:
    """Key expression of the setpoints of all robots and streams of a site."""
    return f"{PREFIX}/{validate_chunk(site, 'site')}/*/stream/*/in"


def every_live(site: str) -> str:
    """Key expression of what people may look at, of all robots and streams of a site."""
    return f"{PREFIX}/{validate_chunk(site, 'site')}/*/stream/*/live"


def every_query(site: str, procedure: str) -> str:
    """Key expression of one procedure (``correct`` or ``describe``) of all robots of a site."""
    return f"{PREFIX}/{validate_chunk(site, 'site')}/*/@rpc/{procedure}"


def every_active(site: str) -> str:
    """Key expression of the version announcements of all robots of a site."""
    return f"{PREFIX}/{validate_chunk(site, 'site')}/*/active"


def robot_from_key(key: str) -> str:
    """Robot named by a key of this module.

    Raises:
        ValueError: not such a key.

    """
    parts = key.split("/")
    if len(parts) < 5 or parts[0] != "kilter" or parts[1] != "@v1":
        raise ValueError(f"{key!r} is not a key of the stream")
    return parts[3]


def stream_from_key(key: str) -> str:
    """Stream named by a key of a stream's direction.

    Raises:
        ValueError: not such a key.

    """
    parts = key.split("/")
    if len(parts) != 7 or parts[4] != "stream":
        raise ValueError(f"{key!r} is not the key of a stream")
    return parts[5]
