"""Which workers have fallen silent, by this process's own clock: those of other machines may be wrong or jump."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from datetime import datetime


class Watch:
    """Sees heartbeats change, or not."""

    def __init__(self, silent_after_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._after, self._clock = silent_after_s, clock
        self._seen: dict[str, tuple[datetime, float]] = {}

    def silent(self, beats: Mapping[str, datetime]) -> dict[str, datetime]:
        """Return the workers whose heartbeat has not changed for long, and that heartbeat."""
        time_s = self._clock()
        for name, at in beats.items():
            if name not in self._seen or self._seen[name][0] != at:
                self._seen[name] = (at, time_s)
        self._seen = {name: seen for name, seen in self._seen.items() if name in beats}
        return {name: at for name, (at, since) in self._seen.items() if time_s - since > self._after}

    def forget(self) -> None:
        """Begin anew: nobody could write a heartbeat while the database was away."""
        self._seen = {}
