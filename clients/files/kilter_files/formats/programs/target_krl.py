"""Joint targets of KUKA's KRL: E6AXIS and AXIS, declared or written into a move; E6POS and POS hold no joints."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from kilter_files.formats.programs.target_list import NUMBER, Step, Targets, line_at, without_comments
from kilter_files.ground.faults import fault

SIGN = r"\{[^{}]{0,40}\bA1\s+[-+\d.]|\bE6(?:AXIS|POS)\s+\w+\s*(?:\[|=)"
AXES = re.compile(r"(?:\b(\w{1,64}(?:\[\d{1,4}\])?)\s?=\s?)?\{\s?(?:E6AXIS\s?:|AXIS\s?:)?\s?(A1\s[^}]{0,500})\}", re.I)
AXIS = re.compile(rf"\bA(\d)\s+({NUMBER})")
POSE = re.compile(
    r"(?:\b(?:E6)?POS\s+(\w{1,64}(?:\[\d{1,4}\])?)\s?=\s?\{|\{\s?(?:E6)?POS\s?:|\b(?:PTP|LIN|CIRC)\s+\{)\s?X\s", re.I
)
MOVE = re.compile(r"^[ \t]*(?:S?PTP|S?LIN|S?CIRC)[ \t]+(\w{1,64}(?:\[\d{1,4}\])?)", re.I | re.M)


def read(path: Path, text: str, found: Targets) -> None:
    """Read the axis targets of a KRL module or data list.

    Raises:
        FileError: a target that lacks axes.

    """
    text = without_comments(text, ";")
    known: dict[str, Step] = {}
    for match in AXES.finditer(text):
        axes = {int(number): float(value) for number, value in AXIS.findall(match[2])}
        line, name = line_at(text, match.start()), match[1] or "axis target"
        if sorted(axes) != list(range(1, len(axes) + 1)) or len(axes) < 4:
            raise fault(path, f"{name} lacks axes: it has {sorted(axes)}", "Correct the target.", line=line)
        found.add(name, [axes[k] for k in sorted(axes)], line)
        known[name.upper()] = (name, found.joints_deg[-1], line)
    found.poses = [(match[1] or "a move", line_at(text, match.start())) for match in POSE.finditer(text)]
    named = {name.upper() for name, _ in found.poses}
    moves = [match[1].upper() for match in MOVE.finditer(text)]
    if known and set(moves) & set(known) and "AXIS TARGET" not in known:
        found.in_order_of_moves(text, lambda: _moves([move for move in moves if move not in named], known))
    else:
        found.notes.append("in the order in which they are written")


def _moves(moves: list[str], known: dict[str, Step]) -> Iterator[Step | None]:
    for move in moves:
        yield known.get(move)
