"""Texts: a count with its thing, characters that nobody sees, what spreadsheets take for formulas."""

from __future__ import annotations

import re

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
