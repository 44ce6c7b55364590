"""A bridge announces itself to the server, for those who look at its page: it is told, and never asked for anything."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from typing import Any

from kilter_client.client import Kilter
from kilter_client.errors import KilterError, NotAuthorisedError, NotFoundError

PERIOD_S = 2.0
LAST_S = 3.0  # for the last word of a bridge that ends


class Announcer:
    """Tells the server every 2 s, and at once when the state changes, in a thread of its own: a server may be slow."""

    def __init__(self, robot: str, run: str, say: Callable[[str], object]) -> None:
        self._robot, self._run, self._say = robot, run, say
        self._news: dict[str, Any] | None = None
        self._changed, self._over = threading.Event(), False
        self._thread = threading.Thread(target=self._announce, name="announcements", daemon=True)
        self._thread.start()

    def update_state(self, document: Mapping[str, Any]) -> None:
        """Take over the state of the bridge."""
        news, before = bridge_status_document(document), self._news
        self._news = news
        if before is None or (before["state"], before["version_id"]) != (news["state"], news["version_id"]):
            self._changed.set()

    def close(self, last: str) -> None:
        """Say the last word, "ended" or "killed", if the server takes it soon."""
        if self._news is not None:
            self._news = self._news | {"state": last}
        self._over = True
        self._changed.set()
        self._thread.join(LAST_S)

    def _announce(self) -> None:
        over = False
        while not over:
            self._changed.wait(PERIOD_S)
            self._changed.clear()
            over, news = self._over, self._news
            if news is not None and not self._send_news(news):
                return

    def _send_news(self, news: Mapping[str, Any]) -> bool:
        """Tell once; False where there is no sense in telling again."""
        try:
            with Kilter() as kilter:
                kilter.robots.announce_bridge(self._robot, self._run, news)
        except (NotAuthorisedError, NotFoundError) as error:
            self._say(f"The server does not show this bridge: {error.detail}")
            return False
        except KilterError:  # it is away; the state says so already
            return True
        return True


def bridge_status_document(document: Mapping[str, Any]) -> dict[str, Any]:
    """What the server is told of a bridge's state."""
    counts: Mapping[str, int] = document["counts"]
    return {
        "kind": document["bridge"],
        "state": document["state"],
        "why": document["why"][:500],
        "version_id": document["version_id"],
        "controller": document["controller"],
        "cycle_ms": 1000.0 * document["cycle_s"],
        "cycles": counts.get("answered", 0),
        "late": counts.get("late", 0),
        "lost": counts.get("lost", 0),
        "refused": sum(document["refused"].values()),
        "offset_deg": math.degrees(max(map(abs, document["offset_rad"]))),
        "largest_offset_deg": math.degrees(document["largest_offset_rad"]),
    }
