"""The page of a live view, on the loopback interface only."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socket import SHUT_WR
from threading import Thread

from kilter_files.ground.errors import UsageError
from kilter_files.rig.live.session import Session

HOST = "127.0.0.1"
PAGE = Path(__file__).with_name("page.html")
POLICY = (
    "default-src 'none'; img-src 'self'; connect-src 'self'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "frame-ancestors 'none'"
)
SILENT_S = 10.0  # after which a connection that sends nothing is closed
MOST_DROPPED = 16  # pieces of a body that nobody reads


@contextmanager
def serve_live_page(session: Session, port: int = 0) -> Iterator[str]:
    """Serve the page of a session while the context lasts; its address.

    Raises:
        UsageError: the port is taken.

    """

    class Handler(_Handler):
        shown = session

    try:
        server = ThreadingHTTPServer((HOST, port), Handler)
    except OSError as error:
        raise UsageError(f"Port {port} of {HOST} is taken: give another --port, or 0 for any.") from error
    server.daemon_threads = True
    thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
    thread.start()
    try:
        yield f"http://{HOST}:{server.server_port}/"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _Handler(BaseHTTPRequestHandler):
    """Answers one request of a connection (HTTP/1.0) and closes it: what follows, such as a body, is never a request."""

    shown: Session
    timeout = SILENT_S

    def do_GET(self) -> None:
        """Page, state and picture."""
        path = self.path.partition("?")[0]
        if not self._of_this_page():
            self._answer(403, "text/plain", b"Open the page by its own address.")
        elif path == "/":
            self._answer(200, "text/html; charset=utf-8", PAGE.read_bytes())
        elif path == "/state":
            self._answer(200, "application/json", json.dumps(self.shown.state).encode())
        elif path == "/picture.jpg" and self.shown.picture:
            self._answer(200, "image/jpeg", self.shown.picture)
        else:
            self._answer(404, "text/plain", b"Nothing is here.")

    def do_POST(self) -> None:
        """Take a view: only for the page itself, whose header no other site may send."""
        if not self._of_this_page() or self.headers.get("X-Kilter") != "take":
            self._answer(403, "text/plain", b"Only the page itself takes views.")
        elif self.path != "/take":
            self._answer(404, "text/plain", b"Nothing is here.")
        else:
            self.shown.request_next_view()
            self._answer(202, "text/plain", b"")

    def _of_this_page(self) -> bool:
        """Whether the browser was given this address, not a name that somebody points here, and no other site asks."""
        port = self.connection.getsockname()[1]
        here = {f"{name}:{port}" for name in (HOST, "localhost")} | ({HOST, "localhost"} if port == 80 else set())
        hosts, origins = self.headers.get_all("Host", []), self.headers.get_all("Origin", [])
        return len(hosts) == 1 and hosts[0] in here and {f"http://{name}" for name in here}.issuperset(origins)

    def _answer(self, status: int, kind: str, body: bytes) -> None:
        self.send_response(status)
        for key, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(body))),
            ("Cache-Control", "no-store"),
            ("Content-Security-Policy", POLICY),
            ("X-Content-Type-Options", "nosniff"),
            ("Cross-Origin-Resource-Policy", "same-origin"),
        ):
            self.send_header(key, value)
        self.end_headers()
        self.wfile.write(body)

    def finish(self) -> None:
        """Close the connection, once what the other side still sends was dropped: a reset would take the answer from it."""
        with suppress(OSError):
            super().finish()
            self.connection.shutdown(SHUT_WR)
            for _ in range(MOST_DROPPED):
                if not self.connection.recv(1 << 16):
                    break

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 (the name that the library gives)
        """Say nothing: the command shows what matters."""
