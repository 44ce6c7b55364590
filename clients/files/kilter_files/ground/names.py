"""Suggestions for misspelt names, and numbers of sessions that have names."""

from __future__ import annotations

import difflib
import unicodedata
import zlib
from collections.abc import Iterable

NAMED_SESSIONS = 1_000_000  # numbers from here on stand for names; smaller ones count within a campaign


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return `` (did you mean 'x'?)`` for the nearest known name, or nothing."""
    near = difflib.get_close_matches(name, list(known), n=1)
    return f" (did you mean {near[0]!r}?)" if near else ""


def number_of_session(name: str) -> int:
    """Return the number that stands for the name of a session."""
    text = unicodedata.normalize("NFC", name.strip())
    return NAMED_SESSIONS + zlib.crc32(text.encode()) % (9 * NAMED_SESSIONS)
