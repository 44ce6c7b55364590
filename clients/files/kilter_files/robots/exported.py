"""Text, names and comments of robot files.

Names of robots: they stand in addresses and topics, so they are plain letters, digits and ``_ . -``.
"""

from __future__ import annotations

import re
import unicodedata
from pathlib import Path
from typing import Any

from kilter_files.ground.errors import FileError, UsageError

NUMBER = re.compile(r"^# number (\S+) (\S+) nominal=(\S+) exported=(\S+)(?: difference=(\S+))?$", re.MULTILINE)
ZERO = re.compile(
    r"^# zero_offset (\S+) (deg|mm)=(\S+)(?: half_width_(?:deg|mm)=(\S+))?(?: state=(\S+))?$", re.MULTILINE
)
SIGN = re.compile(r"^# (Zero offsets: .*)$", re.MULTILINE)


def lists_of_export(content: bytes) -> dict[str, Any]:
    """Both lists of a file that has them, else nothing."""
    text = content.decode("utf-8", "replace")
    numbers = [
        {"where": where, "name": name, "nominal": float(a), "exported": float(b), "difference": float(c) if c else None}
        for where, name, a, b, c in NUMBER.findall(text)
    ]
    offsets = [_offset(*found) for found in ZERO.findall(text)]
    sign = SIGN.search(text)
    if sign is None:
        return {}
    return {"numbers": numbers, "zero_offsets": offsets, "zero_offsets_sign": sign[1]}


def _offset(joint: str, unit: str, value: str, half_width: str, state: str) -> dict[str, Any]:
    half = float(half_width) if half_width else None
    return {"joint": joint, f"offset_{unit}": float(value), f"half_width_{unit}": half, "state": state or "unstated"}


def read_text(path: Path) -> str:
    """Return a file's text, with or without a byte order mark.

    Raises:
        FileError: it is not text.

    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"{path}: cannot be read as text ({error}).", file=str(path)) from error


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
