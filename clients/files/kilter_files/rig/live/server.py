"""The page of a live view, on the loopback interface only."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

from kilter_files.ground.errors import UsageError
from kilter_files.rig.live.session import Session

HOST = "127.0.0.1"
PAGE = Path(__file__).with_name("page.html")
POLICY = "default-src 'none'; img-src 'self'; connect-src 'self'; script-src 'unsafe-inline'; style-src 'unsafe-inline'"


@contextmanager
def page_of(session: Session, port: int = 0) -> Iterator[str]:
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
    shown: Session
    protocol_version = "HTTP/1.1"

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
            self.shown.take_next()
            self._answer(202, "text/plain", b"")

    def _of_this_page(self) -> bool:
        """Whether the browser was given this address, and not a name that somebody points here."""
        name = (self.headers.get("Host") or "").rpartition(":")[0]
        return name in (HOST, "localhost")

    def _answer(self, status: int, kind: str, body: bytes) -> None:
        self.send_response(status)
        for key, value in (
            ("Content-Type", kind), ("Content-Length", str(len(body))), ("Cache-Control", "no-store"),
            ("Content-Security-Policy", POLICY), ("X-Content-Type-Options", "nosniff"),
        ):  # fmt: skip
            self.send_header(key, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 (the name that the library gives)
        """Say nothing: the command shows what matters."""
