"""What the server would refuse in a file, as far as this is known before anything is sent."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from kilter_files.look.summaries import Columns, in_shown_unit
from kilter_files.tables.table import CSV_TYPE, Prepared

LIMIT_TOLERANCE = {"deg": 10.0, "mm": 20.0}  # the server's, which warns about less: see docs/reference/columns.md
JOINT = re.compile(r"q(\d+)_(?:deg|rad|mm|m)")
NAMES = ("camera", "board")  # a cell may hold a name for its number
SEEN = re.compile(r"(?:m\d+[xyz]|tip[xyz])_(?:mm|m)|s?[uv]\d+_px|tilt\d+[xyz]_(?:deg|rad)")  # in some rows only
PLACE = re.compile(r"[xyz]_(?:mm|m)|q[wxyz]|(?:phi|theta|psi)_(?:deg|rad)")
LINK = re.compile(r"link\d+_(?:deg|rad|mm|m)")
KINDS = (
    PLACE,
    LINK,
    *map(re.compile, (r"m\d+x_(?:mm|m)", r"u\d+_px", r"tilt\d+[xyz]_(?:deg|rad)")),
)  # beside each other
SHOWN = 5


def otherwise_separated(prepared: Prepared) -> list[str]:
    """What is wrong with a CSV of contract columns whose cells are not separated by commas: nothing else is known of it."""
    head = prepared.content.split(b"\n", 1)[0]
    if prepared.content_type != CSV_TYPE or not (b";" in head or b"\t" in head):
        return []
    return [
        "its columns are separated by ';' or tabs: kilter measure inspect FILE --draft columns.toml writes a map for --map"
    ]


def refusals(columns: Columns, joints: Sequence[Mapping[str, Any]] | None, lines: Sequence[int] = ()) -> list[str]:
    """Name every rule that is broken, with rows; ``joints`` are those of the robot as the server knows it."""
    beside = sum(any(map(kind.fullmatch, columns)) for kind in KINDS) > 1
    found = [
        f"{name} is empty or not a number {_in_rows([math.isnan(v) for v in values], lines)}"
        for name, values in columns.items()
        if not _may_be_empty(name, beside) and any(math.isnan(v) for v in values)
    ]
    if joints is None:
        return found
    numbers = {int(match[1]): name for name in columns if (match := JOINT.fullmatch(name))}
    if sorted(numbers) != list(range(1, len(joints) + 1)):
        found.append(f"the file has joints {', '.join(map(str, sorted(numbers))) or 'none'}, the robot {len(joints)}")
    for number, joint in enumerate(joints, 1):
        if number in numbers:
            found += _outside(numbers[number], columns[numbers[number]], joint, lines)
    return found


def _may_be_empty(name: str, beside: bool) -> bool:
    """Whether a cell may be missing, or not be a number; ``beside`` says that other rows were measured otherwise."""
    if SEEN.fullmatch(name) or name in NAMES:
        return True
    return beside and bool(PLACE.fullmatch(name) or LINK.fullmatch(name))


def _outside(name: str, values: list[float], joint: Mapping[str, Any], lines: Sequence[int]) -> list[str]:
    unit, shown = in_shown_unit(name, values)
    low, high = joint.get(f"limits_{unit}") or (None, None)
    low, high = -math.inf if low is None else low, math.inf if high is None else high
    beyond = [max(low - v, v - high, 0.0) for v in shown]
    wrong = [size > LIMIT_TOLERANCE[unit] for size in beyond]
    if not any(wrong):
        return []
    where = f"limits {low:.6g} to {high:.6g} {unit} of {joint['name']}"
    return [f"{name} is outside the {where} {_in_rows(wrong, lines)}, by up to {max(beyond):.3g} {unit}"]


def _in_rows(wrong: Sequence[bool], lines: Sequence[int]) -> str:
    rows = [k for k, is_wrong in enumerate(wrong) if is_wrong]
    where = [lines[k] if k < len(lines) else k + 1 for k in rows[:SHOWN]]
    word = "line" if lines else "row"
    more = f" and {len(rows) - SHOWN} more" if len(rows) > SHOWN else ""
    return f"in {len(rows)} rows ({word} {', '.join(map(str, where))}{more})"
