"""Reading what was written long ago: a part that no longer has the form of today is left out, nothing is refused."""

from __future__ import annotations

import copy
from collections.abc import Hashable, Sequence
from functools import cache
from typing import Any, TypeVar, cast

from pydantic import TypeAdapter, ValidationError

T = TypeVar("T")

MOST_REPAIRS = 100


@cache
def _adapter(kind: Hashable) -> TypeAdapter[Any]:
    return TypeAdapter(cast(Any, kind))


def as_written(kind: type[T], document: object) -> T:
    """Read a stored document as ``kind``.

    Raises:
        ValidationError: nothing of it can be read.

    """
    adapter: TypeAdapter[T] = _adapter(cast(Hashable, kind))
    try:
        return adapter.validate_python(document)
    except ValidationError as error:
        rest, found = copy.deepcopy(document), error
    for _ in range(MOST_REPAIRS):
        taken = [_leave_out(rest, one["loc"]) for one in reversed(found.errors(include_url=False))]
        if not any(taken):
            break
        try:
            return adapter.validate_python(rest)
        except ValidationError as error:
            found = error
    raise found


def _leave_out(document: Any, place: Sequence[str | int]) -> bool:
    """Take out what is at a place, or what lacks something there; returns whether there was anything to take out."""
    path: list[tuple[Any, Any]] = []
    node = document
    for key in place:
        inside = (
            isinstance(key, int) and key < len(node)
            if isinstance(node, list)
            else isinstance(node, dict) and key in node
        )
        if not inside:
            break
        path.append((node, key))
        node = node[key]
    if not path:
        return False
    owner, last = path[-1]
    del owner[last]
    return True
