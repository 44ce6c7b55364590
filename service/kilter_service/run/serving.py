"""The API process: one uvicorn on one socket."""

from __future__ import annotations

import errno
import gc
import logging
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from kilter_files.ground.later import later
from kilter_service.ground.backup_folder import wait_for_migration
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.memory import ShortPauses, keep_small
from kilter_service.ground.settings import Settings

with later(__name__):
    from kilter_service.ground import db
    from kilter_service.ground.db import revision

log = logging.getLogger("kilter.api")

BACKLOG = 512
GRACE_S = 3
# Longer than clients keep an idle connection (httpx 5 s): whoever sends must not meet a server that is just closing it.
KEEP_ALIVE_S = 15
# A request changes threads several times, and each time may wait this long behind a thread that computes (Python: 5 ms).
SWITCH_S = 0.0005
MIGRATION_WAIT_S = 30.0  # for `kilterd serve`, which migrates the database while the API starts


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
            f"The API cannot listen on {settings.host} port {settings.port}, {_describe_bind_error(error)}.",
            code="binding_refused",
            host=settings.host,
            port=settings.port,
        ) from error


def _describe_bind_error(error: OSError) -> str:
    """The reason in words, and the setting to change."""
    if error.errno == errno.EADDRINUSE:
        return "another program listens there: set KILTER_PORT (or --port) to another, 0 takes a free one"
    if error.errno == errno.EACCES:
        return (
            "ports below 1024 need rights that this account does not have: set KILTER_PORT (or --port) to a higher one"
        )
    reason = (
        os.strerror(error.errno) if error.errno and error.errno > 0 else error
    )  # an invalid host name has a code below 0
    return f"{reason}: set KILTER_HOST (or --host) to an address of this machine"


def listening_url(opened: socket.socket, settings: Settings) -> str:
    """Return the URL at which a listening socket is reached."""
    host, port = opened.getsockname()[:2]
    if host in ("0.0.0.0", "::"):  # noqa: S104 (compared, not bound)
        host = socket.gethostname()
    scheme = "http" if settings.tls_certificate is None else "https"
    return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"


@contextmanager
def lasting() -> Iterator[None]:
    """Build what lives as long as the process, which the garbage collector need not look through, now or later.

    Of the 1.7 s that importing the application takes, 0.2 s were collections that found nothing, and so were 0.2 s of the
    1.1 s of the worker.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def check_database(settings: Settings, wait_s: float = 0.0) -> None:
    """Wait for the database to have the revision of this Kilter: for a migration here as long as it takes, else ``wait_s``.

    uvicorn would show a traceback instead of the sentence.

    Raises:
        ServiceError: it has another one after ``wait_s``.

    """
    if wait_s:
        wait_for_migration(settings.data)
    database = db.Database(settings.database)
    try:
        revision.wait(database, wait_s)
    finally:
        database.close()


def serve(settings: Settings, opened: socket.socket) -> None:
    """Serve the API until SIGTERM or SIGINT.

    Raises:
        ServiceError: the database is not of the revision of this Kilter.

    """
    keep_small()
    sys.setswitchinterval(SWITCH_S)
    with lasting():
        from uvicorn import Config

        from kilter_service.run.app import create_app
        from kilter_service.web.gate import StreamEndingServer, TimedConnection

        app = create_app(settings)
    ShortPauses().watch_collections()
    check_database(settings, MIGRATION_WAIT_S)
    config = Config(
        app,
        log_config=None,
        access_log=False,
        http=TimedConnection,
        # It would believe what any program on this machine says about where a request comes from (auth/forwarded.py).
        proxy_headers=False,
        ssl_certfile=settings.tls_certificate,
        ssl_keyfile=settings.tls_key,
        # A client that follows a job's events would otherwise keep the server from stopping.
        timeout_graceful_shutdown=GRACE_S,
        timeout_keep_alive=KEEP_ALIVE_S,
    )
    StreamEndingServer(config, app).run(sockets=[opened])
