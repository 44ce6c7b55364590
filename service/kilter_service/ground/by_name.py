"""What is stored, answered and computed under the same names: copied by them, so that a field is not listed again."""

from __future__ import annotations

from typing import Any, TypeVar

T = TypeVar("T")

FIELDS = ("model_fields", "_fields", "__dataclass_fields__")  # where an answer, a tuple and a record name theirs


def copy_fields(kind: type[T], source: object, /, **own: Any) -> T:
    """Return a record or an answer with what ``source`` has under the names of its fields; ``own`` is what it has not.

    Raises:
        TypeError: a field of a record is in neither. ValueError: one of an answer.

    """
    names = next(getattr(kind, fields) for fields in FIELDS if hasattr(kind, fields))
    return kind(**{name: getattr(source, name) for name in names if name not in own and hasattr(source, name)}, **own)
