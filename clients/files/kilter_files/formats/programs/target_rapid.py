"""Joint targets of ABB's RAPID: jointtarget and MoveAbsJ; robtargets are poses and hold no joints."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from kilter_files.formats.programs.target_list import NUMBER, Step, Targets, line_at, without_comments
from kilter_files.ground.faults import fault

SIGN = r"\bjointtarget\b|\bMoveAbsJ\b|\brobtarget\b\s+\w+\s*(?:\{[\d,\s]*\})?\s*:="
UNUSED_AXIS = 8e9  # 9E9 stands for an external axis that is not there
SIX = r"\[\s*" + r"\s*,\s*".join([f"({NUMBER})"] * 6) + r"\s*\]"
PAIR = re.compile(rf"\[\s*{SIX}\s*,\s*{SIX}\s*\]")
DECLARED = re.compile(r"\bjointtarget\s+(\w+)\s*(?:\{[\d,\s]*\})?\s*:=([^;]{0,200000});", re.I)
MOVE = re.compile(r"\bMoveAbsJ\s+(?:(\w+)(?:\s*\{\s*(\d+)\s*\})?\s*[\\,]|(\[[^;]{0,2000});)", re.I)
POSE = re.compile(r"\brobtarget\s+(\w+)\s*(?:\{[\d,\s]*\})?\s*:=", re.I)

Known = dict[str, list[tuple[list[float], int]]]


def read(path: Path, text: str, found: Targets) -> None:
    """Read the joint targets of a RAPID module.

    Raises:
        FileError: a target that is not made of six joints and six external axes.

    """
    text = without_comments(text, "!")
    known: Known = {}
    external = False
    for match in DECLARED.finditer(text):
        pairs = list(PAIR.finditer(match[2]))
        if not pairs or PAIR.sub("", match[2]).strip(" \t\r\n[],"):
            what = f"{match[1]} is not made of six joints and six external axes, [[...],[...]]"
            raise fault(path, what, "Correct the target.", line=line_at(text, match.start()))
        rows = [[float(v) for v in pair.groups()] for pair in pairs]
        external |= any(abs(v) < UNUSED_AXIS and v != 0 for row in rows for v in row[6:])
        known[match[1].lower()] = [
            (row[:6], line_at(text, match.start(2) + pair.start())) for row, pair in zip(rows, pairs, strict=True)
        ]
        for k, (q, line) in enumerate(known[match[1].lower()], 1):
            found.add(match[1] if len(rows) == 1 else f"{match[1]}{{{k}}}", q, line)
    found.poses = [(match[1], line_at(text, match.start())) for match in POSE.finditer(text)]
    if external:
        found.warnings.append("external axes are left out: what they move belongs to the base or the tool")
    found.in_order_of_moves(text, lambda: _moves(text, known))


def _moves(text: str, known: Known) -> Iterator[Step | None]:
    for move in MOVE.finditer(text):
        line = line_at(text, move.start())
        if move[3]:
            pair = PAIR.match(move[3])
            yield ("MoveAbsJ", [float(v) for v in pair.groups()[:6]], line) if pair else None
            continue
        rows, index = known.get(move[1].lower(), []), int(move[2] or 1) - 1
        yield (move[1], rows[index][0], rows[index][1]) if 0 <= index < len(rows) else None
