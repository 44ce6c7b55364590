"""Verdicts posted to the address that the operator named: signed, a bounded number of times, and never in a job's way."""

from __future__ import annotations

import hashlib
import hmac
import http.client
import json
import logging
import queue
import socket
import ssl
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import SplitResult, urlsplit

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.private_files import read_secret_file
from kilter_service.ground.settings import Settings, code_version

log = logging.getLogger("kilter.worker")

WAITS_S = (1.0, 5.0)  # before the second and the third attempt
MOST_WAITING = 100  # verdicts; further ones are counted as failed
MOST_READ = 1 << 10  # bytes of an answer
LEAST_SECRET = 24
SIGNATURE, DELIVERY = "Kilter-Signature", "Kilter-Delivery"
VARIABLE = "KILTER_WEBHOOK_SECRET"


def signature(secret: bytes, at: int, body: bytes) -> str:
    """Return the signature of a body posted at a time: ``t=<seconds since 1970>,v1=<HMAC-SHA256 of "t.body">``."""
    found = hmac.new(secret, f"{at}.".encode() + body, hashlib.sha256)
    return f"t={at},v1={found.hexdigest()}"


class Webhook:
    """Posts in a thread of its own; ``counts`` says how many were sent and how many were given up."""

    def __init__(self, url: str, secret: bytes, timeout_s: float, waits_s: Sequence[float] = WAITS_S) -> None:
        self._url, self._secret, self._timeout_s, self._waits_s = urlsplit(url), secret, timeout_s, waits_s
        self._waiting = queue.Queue[tuple[str, Mapping[str, Any]]](MOST_WAITING)
        self.counts = {"sent": 0, "failed": 0}
        threading.Thread(target=self._work, name="webhook", daemon=True).start()

    @staticmethod
    def from_settings(settings: Settings) -> Webhook | None:
        """The one that is configured; None: none is.

        Raises:
            ServiceError: the file of the secret cannot be used.

        """
        if settings.webhook_url is None or settings.webhook_secret is None:
            return None
        return Webhook(settings.webhook_url, _read_webhook_secret(settings.webhook_secret), settings.webhook_timeout_s)

    def enqueue_message(self, delivery: str, message: Mapping[str, Any]) -> None:
        """Post a message as soon as those before it are done; never waits and never fails."""
        try:
            self._waiting.put_nowait((delivery, message))
        except queue.Full:
            self._record_failure(delivery, f"{MOST_WAITING} others wait")

    def settle(self, seconds: float) -> None:
        """Wait until all are done, and no longer than so many seconds."""
        deadline = time.monotonic() + seconds
        while self._waiting.unfinished_tasks and time.monotonic() < deadline:
            time.sleep(0.02)

    def _work(self) -> None:
        while True:
            delivery, message = self._waiting.get()
            try:
                self._deliver(delivery, json.dumps(message, allow_nan=False).encode())
            except Exception as error:  # one message must not end the thread
                self._record_failure(delivery, type(error).__name__)
            self._waiting.task_done()

    def _deliver(self, delivery: str, body: bytes) -> None:
        wrong = ""
        for wait in (0.0, *self._waits_s):
            time.sleep(wait)
            wrong = self._attempt(delivery, body)
            if not wrong:
                self.counts["sent"] += 1
                return
        self._record_failure(delivery, wrong)

    def _attempt(self, delivery: str, body: bytes) -> str:
        """Post once; return what was wrong, empty where it was taken. A redirection is wrong: nobody follows it."""
        at = int(time.time())
        headers = {
            "Content-Type": "application/json",
            "User-Agent": f"Kilter/{code_version()}",
            DELIVERY: delivery,
            SIGNATURE: signature(self._secret, at, body),
        }
        connection, over, began_s = _connection(self._url, self._timeout_s), threading.Event(), time.monotonic()
        try:
            connection.connect()
            with _ended_after(connection.sock, began_s + self._timeout_s - time.monotonic(), over):
                connection.request("POST", _target(self._url), body, headers)
                answer = connection.getresponse()
                answer.read(MOST_READ)
        except (OSError, http.client.HTTPException) as error:
            return type(TimeoutError() if over.is_set() else error).__name__
        finally:
            connection.close()
        if over.is_set():  # the end of what was sent is not that of the answer
            return TimeoutError.__name__
        if 300 <= answer.status < 400:
            return f"status {answer.status}, and a redirection is not followed"
        return "" if 200 <= answer.status < 300 else f"status {answer.status}"

    def _record_failure(self, delivery: str, why: str) -> None:
        self.counts["failed"] += 1
        log.warning("the verdict of job %s was not taken by KILTER_WEBHOOK_URL: %s", delivery, why)


@contextmanager
def _ended_after(sock: socket.socket, seconds: float, over: threading.Event) -> Iterator[None]:
    """End what a socket receives after so many seconds as a whole, and say so: its own time-out is for each byte."""

    def end() -> None:
        over.set()
        with suppress(OSError):
            sock.shutdown(socket.SHUT_RDWR)

    timer = threading.Timer(max(0.0, seconds), end)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _connection(url: SplitResult, timeout_s: float) -> http.client.HTTPConnection:
    assert url.hostname is not None
    if url.scheme == "https":
        return http.client.HTTPSConnection(
            url.hostname, url.port, timeout=timeout_s, context=ssl.create_default_context()
        )
    return http.client.HTTPConnection(url.hostname, url.port, timeout=timeout_s)


def _target(url: SplitResult) -> str:
    return (url.path or "/") + (f"?{url.query}" if url.query else "")


def _read_webhook_secret(file: Path) -> bytes:
    return read_secret_file(file, "secret", LEAST_SECRET, 0o007, _unusable)


def _unusable(what: str) -> ServiceError:
    return ServiceError(f"The file that {VARIABLE} names {what}.", code="webhook_secret_unusable")
