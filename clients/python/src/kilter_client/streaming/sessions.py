"""Where a stream gets its sessions: from what it was given, from the secret of a corrector on this account, or from the API."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Sequence
from ipaddress import ip_address
from pathlib import Path
from typing import Any

from kilter_client.client import Kilter
from kilter_client.errors import ConflictError, KilterError
from kilter_client.signing import LIFETIME_S, Session, from_document, on_this_machine
from kilter_client.streaming.corrector import StreamError

log = logging.getLogger("kilter.stream")

RENEW_AT = 0.5  # of its lifetime: as much is left to outlast an outage of the API
UNANSWERED_S = 5.0  # a corrector that is there and answers nothing for so long does not know the session's secret


class Sessions:
    """Sessions of one stream. ``signed`` None: sign when a session can be had, or when it must be."""

    def __init__(
        self,
        site: str,
        robot: str,
        stream: str,
        endpoints: Sequence[str],
        found: dict[str, Any],
        signed: bool | None,
        take_over: bool = False,
    ) -> None:
        self._take_over = take_over
        self._address = (site, robot, stream)
        self._endpoints = endpoints
        self._file = Path(found["stream_keys"]) if "stream_keys" in found else None
        self._signed = signed
        self._renew_at = 0.0  # monotonic clock: the other may be set at any moment
        self._asked_at = 0.0

    def initial_session(self, given: Session | None) -> Session | None:
        """The session to begin with; None for an unsigned stream.

        Raises:
            StreamError: there is none, and the stream may not be unsigned.

        """
        if self._signed is False:
            return None
        session = given or self._local() or self._of_api()
        if session is None and (self._signed or not all(map(_is_local, self._endpoints))):
            raise StreamError(
                f"No session for stream {self._address[2]!r} of robot {self._address[1]!r}: set KILTER_URL and KILTER_TOKEN "
                "so that the API gives one, or pass session=. Unsigned setpoints are taken on the corrector's own machine "
                "only (signed=False)."
            )
        self._plan(session)
        return session

    def due(self) -> bool:
        """Whether it is time for the next session."""
        return 0.0 < self._renew_at < time.monotonic()

    def mark_expired(self) -> None:
        """Say that the corrector takes the present session no longer."""
        self._renew_at = 1e-9

    def mark_unanswered(self) -> bool:
        """Say that the corrector answers nothing; returns whether another session is worth a try again."""
        if not 0.0 < self._asked_at < time.monotonic() - UNANSWERED_S:
            return False
        self._asked_at = time.monotonic()
        self.mark_expired()
        return True

    def next_session(self) -> Session | None:
        """Another session; None when there is none at present, and it is tried again in a minute."""
        session = self._local() or self._of_api()
        self._plan(session)
        return session

    def _plan(self, session: Session | None) -> None:
        self._asked_at = time.monotonic()
        left_s = 0.0 if session is None else session.expires_s - time.time()
        if not 0.0 < left_s <= LIFETIME_S:  # the clocks of both machines differ
            left_s = LIFETIME_S
        self._renew_at = self._asked_at + (60.0 if session is None else RENEW_AT * left_s)

    def _local(self) -> Session | None:
        return on_this_machine(self._file, *self._address) if self._file else None

    def _of_api(self) -> Session | None:
        if not os.environ.get("KILTER_URL"):
            return None
        _, robot, stream = self._address
        try:
            with Kilter() as kilter:
                document = kilter.robots.stream_session(robot, stream, LIFETIME_S / 3600.0, self._take_over)
        except KilterError as error:
            if isinstance(error, ConflictError) or self._signed or not all(map(_is_local, self._endpoints)):
                raise StreamError(f"The API gives no session: {error}") from error
            return None
        for warning in document.get("warnings") or ():
            log.warning("%s", warning["message"])
        self._take_over = False  # once: whoever takes it over from this one later is not driven out by the next renewal
        return from_document(document)


def _is_local(endpoint: str) -> bool:
    host = endpoint.partition("/")[2].partition("#")[0].partition("?")[0].rpartition(":")[0].strip("[]")
    if endpoint.startswith(("unixsock-stream/", "unixpipe/")) or host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False
