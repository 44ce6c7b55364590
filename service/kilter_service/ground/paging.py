"""Pages of lists: cursors stay valid when entries are added meanwhile."""

from __future__ import annotations

import base64
import binascii
import json
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import NamedTuple, TypeVar

from kilter_service.ground.errors import ServiceError

T = TypeVar("T")
MOST_DIGITS = 18  # of a number that a database holds


class Page(NamedTuple):
    """At most ``limit`` entries (None: all) after the one with this key: a moment and an id, or a name alone."""

    limit: int | None = None
    after: tuple[str, ...] | None = None

    @property
    def moment(self) -> tuple[datetime, str] | None:
        """The key of a list in time.

        Raises:
            ServiceError: it is the key of another list.

        """
        if self.after is None:
            return None
        try:
            moment, key = self.after
            return datetime.fromisoformat(moment), key
        except ValueError:
            raise _no_cursor() from None

    @property
    def name(self) -> str | None:
        """The key of a list by name or number.

        Raises:
            ServiceError: it is the key of another list.

        """
        if self.after is None:
            return None
        if len(self.after) != 1:
            raise _no_cursor()
        return self.after[0]

    @property
    def number(self) -> int | None:
        """The key of a list by number.

        Raises:
            ServiceError: it is the key of another list.

        """
        name = self.name
        if name is not None and not (name.isascii() and name.isdecimal() and len(name) <= MOST_DIGITS):
            raise _no_cursor()
        return None if name is None else int(name)

    @property
    def fetch_limit(self) -> int | None:
        """How many entries to read: one more than are shown, to know whether there are more."""
        return None if self.limit is None else self.limit + 1

    def cut(self, entries: Sequence[T], key: Callable[[T], tuple[str, ...]]) -> tuple[Sequence[T], str | None]:
        """Return the entries to show, and the cursor of those after them, None when there are none."""
        if self.limit is None or len(entries) <= self.limit:
            return entries, None
        shown = entries[: self.limit]
        return shown, _cursor(key(shown[-1]))


ALL = Page()


def in_time(moment: datetime, key: str) -> tuple[str, ...]:
    """Return the key of an entry of a list in time."""
    return moment.isoformat(), key


def _cursor(key: tuple[str, ...]) -> str:
    return base64.urlsafe_b64encode(json.dumps(key).encode()).decode().rstrip("=")


def decode_cursor(cursor: str) -> tuple[str, ...]:
    """Return the key that a cursor stands for.

    Raises:
        ServiceError: it is not a cursor.

    """
    try:
        found = json.loads(base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)))
    except (ValueError, binascii.Error):
        raise _no_cursor() from None
    if (
        not isinstance(found, list)
        or not found
        or not all(isinstance(part, str) and part.isprintable() for part in found)
    ):
        raise _no_cursor()
    return tuple(found)


def _no_cursor() -> ServiceError:
    return ServiceError(
        "after is not a cursor of this list: give `next` of the page before, or nothing for the first.",
        code="payload_invalid",
        errors=[{"place": "query.after", "message": "not a cursor of this list", "type": "cursor"}],
    )
