"""What was computed lately, kept in memory: at most so much of it, and what was asked for longest ago goes first."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

T = TypeVar("T")


class Recent(Generic[T]):
    """Values by key, of ``most`` in all, as ``size`` counts them (one each). They are shared, and nobody changes them."""

    def __init__(self, most: int, size: Callable[[T], int] = lambda _: 1) -> None:
        self._most, self._size, self._lock = most, size, threading.Lock()
        self._kept = OrderedDict[Hashable, T]()

    def get(self, key: Hashable, compute: Callable[[], T]) -> T:
        """Return a value, computed where it is not kept; meanwhile nobody waits for it."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        found = compute()
        with self._lock:
            if self._size(found) <= self._most:
                self._kept[key] = found
            while sum(map(self._size, self._kept.values())) > self._most:
                self._kept.popitem(last=False)
        return found
