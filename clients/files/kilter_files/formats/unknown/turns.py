"""Which columns of an unknown table are an orientation, and in which convention."""

from __future__ import annotations

import re
from dataclasses import dataclass

from kilter_files.formats.unknown.guess import Columns
from kilter_files.formats.unknown.names import words_of
from kilter_files.ground.units import SIZES, UNKNOWN

QUATERNIONS: tuple[tuple[str, ...], ...] = (
    ("qw", "qx", "qy", "qz"),
    ("q0", "q1", "q2", "q3"),
    ("quat w", "quat x", "quat y", "quat z"),
)
# names of three angles, in the order of rotation -> the convention of whoever uses these names
ANGLES: tuple[tuple[tuple[str, ...], str, str], ...] = (
    (("a", "b", "c"), "ZYX", "KUKA's A, B, C"),
    (("w", "p", "r"), "xyz", "FANUC's W, P, R"),
    (("rx", "ry", "rz"), UNKNOWN, ""),
    (("roll", "pitch", "yaw"), UNKNOWN, ""),
)
ASK = 'order of the angles: "XYZ" about the moving axes, "xyz" about the fixed ones, or delete this table'
UNIT = 0.01


@dataclass(frozen=True)
class Turned:
    """Columns of an orientation; ``quaternion`` or ``euler`` with ``unit``."""

    names: tuple[str, ...]
    quaternion: str = ""
    euler: str = ""
    unit: str = ""
    remark: str = ""

    @property
    def open(self) -> bool:
        """Whether somebody has to fill in what could not be told."""
        return UNKNOWN in (self.euler, self.unit)


def turned(columns: Columns) -> Turned | None:
    """Return the orientation, None where no columns look like one."""
    words = {name: _plain(name) for name in columns.names}
    for parts in QUATERNIONS:
        names = _found(words, parts)
        if names and _is_unit(columns, names):
            return Turned(names, quaternion="wxyz", remark="four parts of length 1")
    for parts, order, whose in ANGLES:
        names = _found(words, parts)
        if names and columns.largest(names) is not None and columns.unit(names[0]) in (None, *SIZES["angle"]):
            unit, remark = _unit(columns, names)
            told = "; ".join(text for text in (whose, f"{UNKNOWN} {ASK}" if order == UNKNOWN else "", remark) if text)
            return Turned(names, euler=order, unit=unit, remark=told)
    return None


def _plain(name: str) -> str:
    """A name without its unit and without words that every column has."""
    said = re.sub(r"\s*[\[(].*$|_(?:deg|rad)$", "", name)
    return re.sub(r"^(?:tcp|tool|pose|meas\w*|act\w*|rot|orientation|quat\w*(?= ?q))\b\s*", "", words_of(said))


def _found(words: dict[str, str], parts: tuple[str, ...]) -> tuple[str, ...]:
    names = [
        next((name for name, said in words.items() if said in (part, part.replace(" ", ""))), "") for part in parts
    ]
    return tuple(names) if all(names) else ()


def _is_unit(columns: Columns, names: tuple[str, ...]) -> bool:
    values = [columns.numbers(name) or [] for name in names]
    if len({len(column) for column in values}) != 1 or not values[0]:
        return False
    return all(abs(sum(v * v for v in row) - 1.0) < UNIT for row in zip(*values, strict=True))


def _unit(columns: Columns, names: tuple[str, ...]) -> tuple[str, str]:
    stated = columns.unit(names[0])
    if stated is not None:
        return stated, ""
    size = columns.largest(names) or 0.0
    if size > 6.6:
        return "deg", f"no unit stated; up to {size:.4g}: degrees"
    return ("rad", f"no unit stated; up to {size:.4g}: radians, check") if size > 0.3 else (UNKNOWN, "deg or rad")
