"""URScript: the joints that movej goes to, in place or by a variable; poses and other moves are named."""

from __future__ import annotations

import re

from kilter_files.formats.programs.found import Program, blanked, numbers_in

DECLARED = re.compile(r"^[ \t]*(?:global[ \t]+|local[ \t]+)?(\w{1,64})[ \t]*=[ \t]*([^\r\n]*)", re.M)
MOVE = re.compile(r"\b((?:move|servo|speed)[jlpc])\s?\(\s*(\[[^\]]{0,500}\]?|\w{1,64}\s?[(\[]?)?")


def find(program: Program) -> None:
    """Find the joints of movej.

    Raises:
        FileError: joints that are not numbers.

    """
    text = blanked(program.text, "#")
    declared: dict[str, list[tuple[int, str]]] = {}
    for match in DECLARED.finditer(text):
        declared.setdefault(match[1], []).append((match.start(2), match[2].rstrip()))
    taken: set[int] = set()
    for match in MOVE.finditer(text):
        goal = (match[2] or "").strip()
        places = [(match.start(2), goal)] if goal.startswith("[") else declared.get(goal, [])
        if match[1] != "movej" or not places or not all(written.startswith("[") for _, written in places):
            program.leave(match.start(), f"{match[1]}({goal[:40]}: no joints of this file")
            continue
        for at, written in places:
            if at not in taken:
                taken.add(at)
                _take(program, "movej" if goal.startswith("[") else goal, at, written)


def _take(program: Program, name: str, at: int, written: str) -> None:
    numbers = numbers_in(program.text, at + 1, at + len(written) - 1) if written.endswith("]") else []
    if not numbers:
        raise program.refuse(at, f"{name} goes to {written[:40]!r}, no list of numbers", "Write the joints in rad.")
    program.add(name, numbers, radians=True)
