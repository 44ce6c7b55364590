"""The API's own way to the corrector of its data folder: one zenoh session, opened while somebody looks.

It goes through the private socket by which the corrector's processes meet, which only their account can reach, or through
the router of the corrector's configuration. So it needs no certificate and nothing listens for it.
"""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from kilter_service.ground.settings import Settings
from kilter_service.stream.corrector import endpoints


class Place(NamedTuple):
    """What the corrector file says."""

    instance: str
    site: str
    private: str
    config: str | None
    endpoint: str  # for controllers
    since: str  # when it was written


def read_corrector_place(file: Path) -> Place | None:
    """Where the corrector is, None when none runs here."""
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        since = datetime.fromtimestamp(file.stat().st_mtime, UTC).isoformat(timespec="seconds")
        to = document["endpoints"]["stream"]
        return Place(document["instance"], document["site"], document["private"], document["zenoh_config"], to, since)
    except (OSError, ValueError, KeyError):
        return None


class Message(NamedTuple):
    """A message of a stream."""

    key: str
    data: bytes


class LiveSession:
    """An open session, and its subscription to all streams of the site."""

    def __init__(self, place: Place) -> None:
        import zenoh  # not before somebody looks

        from kilter_service.stream.corrector.session import config, is_client

        self.place = place
        file = Path(place.config) if place.config else None
        made = config(None, () if is_client(file) else (place.private,), file)
        made.insert_json5("mode", '"client"')
        self._session: Any = zenoh.open(made)
        self._no_message: type[Exception] = zenoh.ZError
        self._subscriber = self._session.declare_subscriber(
            endpoints.every_live(place.site), zenoh.handlers.RingChannel(1024)
        )

    @property
    def is_connected(self) -> bool:
        """Whether the corrector, or its router, is at the other end."""
        try:
            return bool([*self._session.info.peers_zid(), *self._session.info.routers_zid()])
        except self._no_message:
            return False

    def messages(self) -> list[Message]:
        """What was published since."""
        found: list[Message] = []
        try:
            while (sample := self._subscriber.handler.try_recv()) is not None:
                found.append(Message(str(sample.key_expr), sample.payload.to_bytes()))
        except self._no_message:  # the session was closed
            pass
        return found

    def close(self) -> None:
        """Close it."""
        self._session.close()


def open_or_reuse_session(settings: Settings, known: LiveSession | None) -> LiveSession | None:
    """A session with the corrector that runs now: ``known`` when it is still that one, None when there is none."""
    place = read_corrector_place(settings.corrector_file)
    if known is not None:
        if place is None or place.instance == known.place.instance:
            return known
        known.close()
    try:
        return None if place is None else LiveSession(place)
    except Exception as error:
        import zenoh

        if not isinstance(error, zenoh.ZError):
            raise
        return None
