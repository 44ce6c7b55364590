"""What people call a version, a job or a campaign; what is copied by its name; and texts: counts, unseen characters."""

from __future__ import annotations

import re
from datetime import datetime
from typing import Any, Protocol, TypeVar

from kilter_service.contract.jobs.registry import KINDS


class Made(Protocol):
    """What was made some time, and may have a name."""

    @property
    def name(self) -> str:
        """The name that somebody gave it, or none."""

    @property
    def created_at(self) -> datetime:
        """When it was made."""


def display_name(made: Made) -> str:
    """Return what people call it: its name, a version's number, else when it was made, to the second."""
    if made.name:
        return made.name
    if number := getattr(made, "number", 0):
        return f"{getattr(made, 'robot', '')} v{number}"
    # Of a job by its kind, of a version none: whoever reads need not know what an id stands for.
    if (kind := getattr(made, "kind", "")) in KINDS:
        return name_unnamed_job(kind, getattr(made, "robot", ""), made.created_at)
    what = "version" if hasattr(made, "job_id") else "campaign"
    return f"{what} of {made.created_at:%Y-%m-%d %H:%M:%S}"


def job_noun(kind: str) -> str:
    """Return what people call a job of a kind: "gap search"."""
    known = KINDS.get(kind)
    return "job" if known is None else known.noun.partition(" of ")[0]


def name_unnamed_job(kind: str, robot: str, created_at: datetime) -> str:
    """Return what a job of an earlier release is called that nobody named: "gap search of tour, 2026-11-02 14:05:09"."""
    return f"{job_noun(kind)} of {robot}, {created_at:%Y-%m-%d %H:%M:%S}"


T = TypeVar("T")

FIELDS = ("model_fields", "_fields", "__dataclass_fields__")  # where an answer, a tuple and a record name theirs


def copy_fields(kind: type[T], source: object, /, **own: Any) -> T:
    """Return a record or an answer with what ``source`` has under the names of its fields; ``own`` is what it has not.

    Raises:
        TypeError: a field of a record is in neither. ValueError: one of an answer.

    """
    names = next(getattr(kind, fields) for fields in FIELDS if hasattr(kind, fields))
    return kind(**{name: getattr(source, name) for name in names if name not in own and hasattr(source, name)}, **own)


# NUL ends a text in PostgreSQL; half a surrogate pair has no UTF-8.
_NEVER = r"\x00\ud800-\udfff"
# What makes a terminal or a page show another text than is stored: other control characters, line separators, and marks
# of no width that change the direction or hide between letters.
_HIDDEN = (
    r"\x01-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\xad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    r"\U000e0000-\U000e007f"
)
_LINES = r"\t\n\r"
ANY, LINES, LINE = (re.compile(f"[{marks}]") for marks in (_NEVER, _NEVER + _HIDDEN, _NEVER + _HIDDEN + _LINES))
FORMULA = ("=", "+", "-", "@", "\t", "\r")


def text_cell(text: str) -> str:
    """Return a text for a cell of CSV: one that a spreadsheet would compute gets an apostrophe, which it hides."""
    return f"'{text}" if text.startswith((*FORMULA, "'")) else text


def plural(count: int, thing: str) -> str:
    """Write a count with its thing."""
    return f"{count} {thing}{'' if count == 1 else 's'}"
