"""FANUC LS: positions that are shown as joints; other motion groups stay, poses and registers are named."""

from __future__ import annotations

import re

from kilter_files.formats.programs.found import Program
from kilter_files.formats.programs.target_list import NUMBER

POSITION = re.compile(r"\bP\[\s?(\d+)\s?(?::[^\]\n]{0,80})?\]\s?\{([^}]{0,2000})(\};?|\Z)")
AXIS = re.compile(r"\bJ(\d)\s?=\s{0,9}([^\s,]+)\s{0,9}(deg|mm)?")
OTHER_GROUP = re.compile(r"\bGP[2-9]\s?:")
MOVE = re.compile(r"^\s*\d+\s*:\s*([JLCAS]\s+(P|PR)\[\s*(\d+|[^\]]{1,80})[^\]\n]{0,80}\])", re.M)


def find(program: Program) -> None:
    """Find the positions given as joints.

    Raises:
        FileError: one whose joints are not numbers in deg, or a program that is cut.

    """
    text = program.text
    if re.search(r"^\s*/PROG\b", text, re.M) and not re.search(r"^\s*/END\b", text, re.M):
        raise program.refuse(len(text), "ends without /END", "Copy or export it again.")
    program.least_decimals = 3
    known = set()
    for match in POSITION.finditer(text):
        other = OTHER_GROUP.search(match[2])
        arm = [*AXIS.finditer(text, match.start(2), match.start(2) + other.start() if other else match.end(2))]
        if not arm:
            program.leave(match.start(), f"P[{match[1]}], a pose")
            continue
        wrong = [part for part in arm if not re.fullmatch(NUMBER, part[2]) or part[3] != "deg"]
        if wrong or match[3][:1] != "}" or [int(part[1]) for part in arm] != [*range(1, len(arm) + 1)]:
            what = f"P[{match[1]}] is not J1, J2, ... with numbers in deg"
            raise program.refuse(match.start(), what, "Correct the position, or export it again.")
        known.add(match[1])
        program.add(f"P[{match[1]}]", [(part[2], part.span(2)) for part in arm])
    for match in MOVE.finditer(text):
        if match[2] != "P" or match[3] not in known:
            program.leave(match.start(1), f"{match[1]}: no position of this file with joints")
