"""Endpoints the corrector may listen on, and where its two processes meet; without zenoh, so that a start can check early."""

from __future__ import annotations

import errno
import ipaddress
import socket
from pathlib import Path

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.files.private_files import Scratch, scratch_for_sockets
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
