"""RAPID: jointtargets, declared or written into MoveAbsJ; external axes stay, robtargets are named."""

from __future__ import annotations

import re

from kilter_files.formats.programs.found import Program, blanked
from kilter_files.formats.programs.target_rapid import PAIR, POSE

DECLARED = re.compile(r"\bjointtarget\s+(\w+)\s*(?:\{[\d,\s]*\})?\s*:=([^;]{0,200000})(;|\Z)", re.I)
MOVE = re.compile(r"\b(Move\w{1,20}|TriggL|TriggJ|TriggC|SearchL|SearchC)\s+([^;]{0,2000})(;|\Z)", re.I)
GOAL = re.compile(r"(\w+)(?:\s*\{[^}]{0,80}\})?\s*[\\,]")


def find(program: Program) -> None:
    """Find the jointtargets.

    Raises:
        FileError: one that is not made of six joints and six external axes, or a module that is cut.

    """
    text = blanked(program.text, "!")
    if re.search(r"^\s*MODULE\b", text, re.I | re.M) and not re.search(r"^\s*ENDMODULE\b", text, re.I | re.M):
        raise program.refuse(len(text), "ends without ENDMODULE", "Copy or export it again.")
    known = set()
    for match in DECLARED.finditer(text):
        pairs = [*PAIR.finditer(text, match.start(2), match.end(2))]
        if not pairs or match[3] != ";" or PAIR.sub("", match[2]).strip(" \t\r\n[],"):
            what = f"{match[1]} is not made of six joints and six external axes, [[...],[...]]"
            raise program.refuse(match.start(), what, "Correct the target.")
        known.add(match[1].lower())
        for pair in pairs:
            _take(program, match[1], pair)
    for match in POSE.finditer(text):
        program.leave(match.start(), f"{match[1]}, a robtarget")
    for match in MOVE.finditer(text):
        written = PAIR.match(text, match.start(2)) if match[1].lower() == "moveabsj" else None
        goal = GOAL.match(match[2])
        if written is not None:
            _take(program, match[1], written)
        elif match[1].lower() != "moveabsj" or goal is None or goal[1].lower() not in known:
            program.leave(
                match.start(), f"{match[1]} {match[2].split(',')[0].strip()[:40]}: no jointtarget of this file"
            )


def _take(program: Program, name: str, pair: re.Match[str]) -> None:
    program.add(name, [(pair[k], pair.span(k)) for k in range(1, 7)])
