"""Joint targets of FANUC's LS programs: positions shown as joints; those shown as poses hold none."""

from __future__ import annotations

import re
from pathlib import Path

from kilter_files.formats.programs.target_list import NUMBER, Step, Targets, line_at
from kilter_files.ground.faults import fault

SIGN = r"^\s*/(?:PROG|POS)\b"
POSITION = re.compile(r"P\[\s?(\d+)\s?(?::[^\]]{0,80})?\]\s?\{([^}]{0,2000})\}\s?;")
AXIS = re.compile(rf"\bJ(\d)\s?=\s{{0,9}}({NUMBER})\s{{0,9}}(deg|mm)")
GROUP = re.compile(r"\bGP(\d)\s?:")
MOVE = re.compile(r"^\s*\d+\s*:\s*[JLC]\s+P\[\s*(\d+)", re.M)


def read(path: Path, text: str, found: Targets) -> None:
    """Read the positions of an LS program.

    Raises:
        FileError: positions that are given as poses, all of them named, or one that lacks joints.

    """
    known: dict[str, Step] = {}
    groups = False
    for match in POSITION.finditer(text):
        arm, more = _first_group(match[2])
        groups |= more
        axes = {int(number): float(value) for number, value, unit in AXIS.findall(arm) if unit == "deg"}
        line = line_at(text, match.start())
        if not axes:
            found.poses.append((f"P[{match[1]}]", line))
        elif sorted(axes) != list(range(1, len(axes) + 1)):
            what = f"P[{match[1]}] has joints {sorted(axes)}"
            raise fault(path, what, "Correct the position, or export again.", line=line)
        else:
            known[match[1]] = (f"P[{match[1]}]", [axes[k] for k in sorted(axes)], line)
    if found.poses:
        number = len(found.poses)
        what = f"{found.poses[0][0]} is given as a pose" if number == 1 else f"are given as poses: {found.poses_said()}"
        remedy = "Show it as joints on the pendant (REPRE) and export again."
        raise fault(path, what, remedy.replace("it", "them", 1) if number > 1 else remedy, line=found.poses[0][1])
    for target in known.values():
        found.add(*target)
    found.notes.append("FANUC reads J3 against the horizontal: the robot needs --follows J3=J2")
    if groups:
        found.warnings.append("motion groups beside GP1 are left out: what they move belongs to the base or the tool")
    found.in_order_of_moves(text, lambda: (known.get(move) for move in MOVE.findall(text)))


def _first_group(body: str) -> tuple[str, bool]:
    """The part of a position that belongs to the arm, and whether there are other groups."""
    places = [(match.start(), match[1]) for match in GROUP.finditer(body)]
    others = [at for at, number in places if number != "1"]
    return (body[: min(others)] if others and places[0][1] == "1" else body), bool(others)
