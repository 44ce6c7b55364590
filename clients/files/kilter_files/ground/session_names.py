"""Numbers of sessions that have names: the same in every file, so that sessions of one name are one."""

from __future__ import annotations

import unicodedata
import zlib

NAMED_SESSIONS = 1_000_000  # numbers from here on stand for names; smaller ones count within a campaign


def number_of_session(name: str) -> int:
    """Return the number that stands for the name of a session."""
    text = unicodedata.normalize("NFC", name.strip())
    return NAMED_SESSIONS + zlib.crc32(text.encode()) % (9 * NAMED_SESSIONS)
