"""How large a thing may be before Kilter looks at it; what a server may change is in its settings, what a request may
say in the contract.

What was computed lately, kept in memory: at most so much of it, and what was asked for longest ago goes first.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

# Columns: 32 joints in six quantities, 99 markers and everything else together make fewer than 600.
MAX_COLUMNS = 1000
MAX_NAME = 64
MAX_HEADER_BYTES = 1 << 16
MAX_LINE_BYTES = 1 << 20
MAX_CELL = 400  # characters of a number: the longest double written out without an exponent has fewer

# Tables. What is decoded at once is `BATCH_CELLS`, whatever the file has.
MAX_CELLS = 50_000_000
BATCH_CELLS = 2_000_000
MAX_TRAJECTORY_ROWS = 2_000_000
MAX_TRAJECTORY_CELLS = 20_000_000  # a trajectory is corrected as a whole, in several times its size
MAX_ROS2_ROWS = 200_000  # a JointTrajectory is text, 250 bytes a point
MAX_CIRCLE_ROWS = 50_000
MAX_CIRCLE_CELLS = 2_000_000
MAX_JSON_BYTES = 32 << 20  # JSON columns take ten times their size in memory
MAX_FOOTER_BYTES = 2 << 20
MAX_PAGES = 100_000
MAX_PAGES_BYTES = 256 << 20  # the largest pages of all columns of a Parquet file, which are in memory together

MAX_CIRCLE_MB = 64
MAX_MESH_MB, MAX_TRIANGLES = 16, 100_000  # of the shape of a link, which is drawn
MAX_DOCUMENT_PARTS = 200_000  # fields, lists and objects of a JSON document, which are parsed in one call
MAX_DOCUMENT_KEYS = 1000  # fields of one object in a JSON document
MAX_DOCUMENT_DEPTH = 32  # levels of a JSON document
MAX_NUMBER = 1e15  # of a JSON document; its square is far from overflow

# Robots: a serial arm; a URDF may hold a whole machine around it.
MAX_LINKS = 1000
MAX_LINK_NAME = 128
MAX_XML_TAGS = 50_000
MAX_XML_DEPTH = 64
MAX_XML_ATTRIBUTES = 64
MAX_XML_VALUE = 4096


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
