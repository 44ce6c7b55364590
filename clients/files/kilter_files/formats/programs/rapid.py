"""ABB's RAPID: jointtargets, declared or written into MoveAbsJ; external axes stay, robtargets are named."""

from __future__ import annotations

import re

from kilter_files.formats.programs.found import NUMBER, Dialect, JointTarget, Program, blanked, line_at, sign

UNUSED_AXIS = 8e9  # 9E9 stands for an external axis that is not there
SIX = r"\[\s*" + r"\s*,\s*".join([f"({NUMBER})"] * 6) + r"\s*\]"
PAIR = re.compile(rf"\[\s*{SIX}\s*,\s*{SIX}\s*\]")
DECLARED = re.compile(r"\bjointtarget\s+(\w+)\s*(?:\{[\d,\s]*\})?\s*:=([^;]{0,200000})(;|\Z)", re.I)
POSE = re.compile(r"\brobtarget\s+(\w+)\s*(?:\{[\d,\s]*\})?\s*:=", re.I)
MOVE = re.compile(r"\b(Move\w{1,20}|TriggL|TriggJ|TriggC|SearchL|SearchC)\s+([^;]{0,2000})(;|\Z)", re.I)
GOAL = re.compile(r"(\w+)(?:\s*\{\s*(\d*)[^}]{0,80}\})?\s*[\\,]")

Known = dict[str, list[JointTarget]]


def find(program: Program) -> None:
    """Find the jointtargets.

    Raises:
        FileError: one that is not made of six joints and six external axes.

    """
    text = blanked(program.text, "!")
    known: Known = {}
    for match in DECLARED.finditer(text):
        pairs = [*PAIR.finditer(text, match.start(2), match.end(2))]
        if not pairs or match[3] != ";" or PAIR.sub("", match[2]).strip(" \t\r\n[],"):
            what = f"{match[1]} is not made of six joints and six external axes, [[...],[...]]"
            raise program.refuse(match.start(), what, "Correct the target.")
        names = [match[1]] if len(pairs) == 1 else [f"{match[1]}{{{k}}}" for k in range(1, len(pairs) + 1)]
        known[match[1].lower()] = [_take(program, name, pair) for name, pair in zip(names, pairs, strict=True)]
    for match in POSE.finditer(text):
        program.leave_pose(match.start(), match[1], f"{match[1]}, a robtarget")
    for match in MOVE.finditer(text):
        _follow(program, text, match, known)


def _follow(program: Program, text: str, match: re.Match[str], known: Known) -> None:
    joints = match[1].lower() == "moveabsj"
    written = PAIR.match(text, match.start(2)) if joints else None
    goal = GOAL.match(match[2])
    targets = known.get(goal[1].lower(), []) if goal is not None else []
    if written is not None:
        program.moves.append(_take(program, match[1], written))
    elif joints and goal is not None and targets:
        index = int(goal[2] or 1) - 1
        program.moves.append(targets[index] if 0 <= index < len(targets) else None)
    else:
        program.leave(match.start(), f"{match[1]} {match[2].split(',')[0].strip()[:40]}: no jointtarget of this file")
        program.moves += [None] if joints else []


def _take(program: Program, name: str, pair: re.Match[str]) -> JointTarget:
    if any(abs(value) < UNUSED_AXIS and value != 0 for value in map(float, pair.groups()[6:])):
        warning = "external axes are left out: what they move belongs to the base or the tool"
        program.warnings += [] if warning in program.warnings else [warning]
    numbers = [(pair[k], pair.span(k)) for k in range(1, 7)]
    return program.add(name, numbers, line=line_at(program.text, pair.start()))


DIALECT = Dialect(
    "RAPID",
    (".mod",),
    sign(r"\bjointtarget\b|\bMoveAbsJ\b|\brobtarget\b\s+\w+\s*(?:\{[\d,\s]*\})?\s*:="),
    find,
    "Store jointtargets: CJointT() reads the joints where the arm stands",
    (r"^\s*MODULE\b", r"^\s*ENDMODULE\b", "ENDMODULE"),
)
