"""Names of robots: they stand in addresses and topics, so they are plain letters, digits and ``_ . -``."""

from __future__ import annotations

import re
import unicodedata

from kilter_files.ground.errors import UsageError

PLAIN = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
SPELT = {"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "æ": "ae", "ø": "oe", "å": "aa", "ł": "l"}


def plain_name(text: str) -> str:
    """Return the nearest plain name: umlauts spelt out, accents and what else is not plain left out or made a hyphen."""
    text = unicodedata.normalize("NFC", text)
    spelt = "".join(
        SPELT[c] if c in SPELT else SPELT[c.lower()].capitalize() if c.lower() in SPELT else c for c in text
    )
    bare = unicodedata.normalize("NFKD", spelt).encode("ascii", "ignore").decode()
    joined = re.sub(r"[^A-Za-z0-9_.]+", "-", bare).strip("-_.")
    return joined[:64] or "robot"


def checked_name(name: str) -> str:
    """Return a robot's name.

    Raises:
        UsageError: it holds other letters; the nearest plain one is named.

    """
    if not PLAIN.fullmatch(name):
        raise UsageError(
            f"The robot's name {name!r} has other characters than letters A to Z, digits and _ . - (64 at most): it is part of "
            f"addresses and topics. Give --name {plain_name(name)}; campaigns, files and columns may have any name."
        )
    return name
