"""Results that are worth keeping for a while: the ones used last, up to so many bytes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")

MOST_BYTES = 32 << 20  # a selection looks back at a few sets; without a limit a search kept gigabytes of them
EACH = 200  # bytes of an entry besides its arrays


class Recent:
    """A store of results by key that forgets those not used for longest."""

    def __init__(self, most: int = MOST_BYTES) -> None:
        self.most, self.bytes = most, 0
        self._kept: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()

    def __contains__(self, key: Hashable) -> bool:
        return key in self._kept

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what ``make`` gives, made again only where it was forgotten."""
        found = self._kept.get(key)
        if found is not None:
            self._kept.move_to_end(key)
            value: T = found[0]
            return value
        made = make()
        size = _size(made)
        self._kept[key] = (made, size)
        self.bytes += size
        while self.bytes > self.most and len(self._kept) > 1:
            self.bytes -= self._kept.popitem(last=False)[1][1]
        return made


def _size(value: Any) -> int:
    if isinstance(value, np.ndarray):
        return int(value.nbytes)
    if isinstance(value, tuple | list):
        return EACH + sum(_size(v) for v in value)
    return EACH
