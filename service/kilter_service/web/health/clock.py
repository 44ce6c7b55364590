"""By how much the clock of this machine was set a moment ago: what was said before is dated by the old one."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

LEAST_S = 2.0  # a clock that is disciplined creeps, and is never set by so much


class SetClock:
    """Compares the time of day with the monotonic clock each time it is asked."""

    def __init__(
        self, for_s: float, clock: Callable[[], float] = time.time, steady: Callable[[], float] = time.monotonic
    ) -> None:
        self._for_s, self._clock, self._steady = for_s, clock, steady
        self._lock = threading.Lock()
        self._between = clock() - steady()
        self._sets: list[tuple[float, float]] = []

    def sets_s(self) -> list[float]:
        """By how much it was set in the last seconds, forward positive; each as a heartbeat from before it shows it."""
        with self._lock:
            steady_s = self._steady()
            between = self._clock() - steady_s
            self._sets = [(at, s) for at, s in self._sets if steady_s - at < self._for_s]
            by = between - self._between
            if abs(by) > LEAST_S:
                self._sets = [(at, s + by) for at, s in self._sets] + [(steady_s, by)]
            self._between = between
            return [s for _, s in self._sets]
