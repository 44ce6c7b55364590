"""Joint targets of Universal Robots' URScript: movej to joints, given in place or by the name of a variable."""

from __future__ import annotations

import math
import re
from pathlib import Path

from kilter_files.formats.programs.target_list import NUMBER, Targets, line_at, without_comments
from kilter_files.ground.faults import fault

SIGN = r"\bmovej\s*\("
DECLARED = re.compile(r"^[ \t]*(?:global[ \t]+|local[ \t]+)?(\w{1,64})[ \t]*=[ \t]*(p?)\[([^\]]{0,500})\]", re.M)
MOVE = re.compile(r"\bmovej\s?\(\s?(?:(p?)\[([^\]]{0,500})\]|(get_inverse_kin)\s?\(([^)]{0,500})\)|(\w{1,64}))")
OTHER_MOVE = re.compile(r"\bmove[lpc]\s?\(")
NEAR = re.compile(r"\bqnear\s?=\s?(?:(\w{1,64})|\[([^\]]{0,500})\])")
DEGREES = re.compile(rf"d2r\(\s?({NUMBER})\s?\)")


def read(path: Path, text: str, found: Targets) -> None:
    """Read the joints that movej goes to, in the order of the program.

    Raises:
        FileError: a variable that is not set to numbers in the program, values that are not numbers, or degrees.

    """
    text = without_comments(text, "#")
    joints = {match[1]: match[3] for match in DECLARED.finditer(text) if not match[2]}
    poses = {match[1] for match in DECLARED.finditer(text) if match[2]}
    near = 0
    for match in MOVE.finditer(text):
        line, name = line_at(text, match.start()), match[5] or "movej"
        written = match[2] if match[2] is not None else None if match[5] is None else joints.get(match[5])
        if match[3]:
            hint = NEAR.search(match[4])
            written = None if hint is None else hint[2] or joints.get(hint[1] or "")
            name = hint[1] if hint is not None and hint[1] else name
            near += written is not None
        if match[1] or match[5] in poses or (match[3] and written is None):
            found.poses.append((name, line))
            continue
        if written is None:
            what = f"movej goes to {match[5]!r}, to which this program assigns no joints"
            raise fault(path, what, f"Write {match[5]} = [...] before it, or the joints instead.", line=line)
        found.add(name, _degrees(path, written, line), line)
    found.poses += [("a move along a line or arc", line_at(text, match.start())) for match in OTHER_MOVE.finditer(text)]
    if near:
        found.warnings.append(
            f"{near} moves to a pose count with the joints of their qnear: where the waypoint was taught"
        )
    found.notes.append("in the order in which the program moves to them")


def _degrees(path: Path, written: str, line: int) -> list[float]:
    cells = [DEGREES.sub(lambda m: repr(math.radians(float(m[1]))), cell) for cell in written.split(",")]
    try:
        radians = [float(cell) for cell in cells]
    except ValueError as error:
        raise fault(path, f"movej goes to {written[:40]!r}, no numbers", "Give numbers.", line=line) from error
    if any(not abs(v) <= 4.2 * math.pi for v in radians):
        raise fault(path, "movej moves by more than two turns: are these degrees", "Give radians.", line=line)
    return [math.degrees(v) for v in radians]
