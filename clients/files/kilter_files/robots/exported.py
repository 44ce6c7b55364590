"""What an exported table says of itself in its comments: nominal and exported numbers, and zero offsets."""

from __future__ import annotations

import re
from typing import Any

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
