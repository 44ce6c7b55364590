"""How often one sender may ask for what computes or changes something: so many a second, and some at once."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from kilter_service.ground.errors import ServiceError

BURST_S = 10.0  # what a sender has saved up after that many seconds of silence
MOST_SENDERS = 10_000


class Rates:
    """A bucket for each sender, which fills with time; every request takes one from it."""

    def __init__(self, per_second: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate, self._clock = per_second, clock
        self._full = max(1.0, per_second * BURST_S)
        self._buckets: dict[str, tuple[float, float]] = {}  # what is in it, and when that was

    def count_request(self, sender: str) -> None:
        """Count a request.

        Raises:
            ServiceError: the sender has asked too often; the context says when to ask again.

        """
        moment = self._clock()
        left = self._remaining_tokens(sender, moment)
        if left < 1.0:
            wait_s = max(1, math.ceil((1.0 - left) / self._rate))
            raise ServiceError(
                f"More than {self._rate:g} requests a second that compute or change something: send this one again in "
                f"{wait_s} s (KILTER_RATE on the server is the limit).",
                code="rate_limited",
                retry_after_s=wait_s,
            )
        if len(self._buckets) >= MOST_SENDERS and sender not in self._buckets:
            self._buckets = {
                name: was for name, was in self._buckets.items() if self._remaining_tokens(name, moment) < self._full
            }
        self._buckets[sender] = (left - 1.0, moment)

    def _remaining_tokens(self, sender: str, moment: float) -> float:
        left, since = self._buckets.get(sender, (self._full, moment))
        return min(self._full, left + (moment - since) * self._rate)
