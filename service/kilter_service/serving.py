"""The API process: one uvicorn on one socket."""

from __future__ import annotations

import errno
import logging
import os
import socket

from kilter_service.errors import ServiceError
from kilter_service.settings import Settings

log = logging.getLogger("kilter.api")

BACKLOG = 512
GRACE_S = 3


def listener(settings: Settings) -> socket.socket:
    """Open the socket the API listens on; port 0 takes a free one.

    Raises:
        ServiceError: the system does not allow it, or the port is taken.

    """
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    try:
        return socket.create_server((settings.host, settings.port), family=family, backlog=BACKLOG)
    except OSError as error:
        raise ServiceError(
            f"The API cannot listen on {settings.host} port {settings.port}, {_why(error)}.",
            code="binding_refused",
            host=settings.host,
            port=settings.port,
        ) from error


def _why(error: OSError) -> str:
    """The reason in words, and the setting to change."""
    if error.errno == errno.EADDRINUSE:
        return "another program listens there: set KILTER_PORT (or --port) to another, 0 takes a free one"
    if error.errno == errno.EACCES:
        return (
            "ports below 1024 need rights that this account does not have: set KILTER_PORT (or --port) to a higher one"
        )
    reason = (
        os.strerror(error.errno) if error.errno and error.errno > 0 else error
    )  # a name that is none has a code below 0
    return f"{reason}: set KILTER_HOST (or --host) to an address of this machine"


def url_of(opened: socket.socket) -> str:
    """Return the URL at which a listening socket is reached."""
    host, port = opened.getsockname()[:2]
    if host in ("0.0.0.0", "::"):
        host = socket.gethostname()
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def serve(settings: Settings, opened: socket.socket) -> None:
    """Serve the API until SIGTERM or SIGINT."""
    import uvicorn

    from kilter_service.app import MIGRATION_WAIT_S, create_app

    config = uvicorn.Config(
        create_app(settings, migration_wait_s=MIGRATION_WAIT_S),
        log_config=None,
        access_log=False,
        # A client that follows a job's events would otherwise keep the server from stopping.
        timeout_graceful_shutdown=GRACE_S,
    )
    uvicorn.Server(config).run(sockets=[opened])
