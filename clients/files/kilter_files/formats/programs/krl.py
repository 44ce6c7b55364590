"""KUKA's KRL: axis targets in braces, of ``.src`` and ``.dat``; external axes stay, poses are named."""

from __future__ import annotations

import re

from kilter_files.formats.programs.found import NUMBER, Dialect, JointTarget, Program, blanked, line_at, sign
from kilter_files.formats.programs.krl_lines import MOTIONS, not_kept

NAME = r"\w{1,64}(?:\[\d{1,4}\])?"
AXES = re.compile(
    rf"(?:\b({NAME})\s{{0,9}}=\s{{0,9}})?\{{\s{{0,9}}(?:(?:E6)?AXIS\s{{0,9}}:)?\s{{0,9}}(A\d\s[^{{}}]{{0,500}})(\}}|\Z|\{{)",
    re.I,
)
AXIS = re.compile(rf"\s{{0,9}}([AE])(\d)\s{{1,9}}({NUMBER})\s{{0,9}}", re.I)
POSE = re.compile(
    rf"(?:\b(?:E6)?POS\s{{1,9}}({NAME})\s{{0,9}}=\s{{0,9}})?"
    r"\{\s{0,9}((?:E6)?POS\s{0,9}:)?\s{0,9}[XYZ]\s[^{}\n]{0,500}\}",
    re.I,
)
MOVE = re.compile(rf"^[ \t]*({MOTIONS})(?:[ \t]+|(?=\{{))([^\r\n]+)", re.I | re.M)
LINE_END = re.compile(r"\n")


def find(program: Program) -> None:
    """Find the axis targets, and name the lines that may move the arm otherwise.

    Raises:
        FileError: one that lacks axes, has other than numbers, or is cut.

    """
    text = blanked(program.text, ";")
    moves, lists = list(MOVE.finditer(text)), list(AXES.finditer(text))
    relative = [match.span() for match in moves if match[1].upper().endswith("_REL")]
    declared = program.beside
    known = {} if declared is None else {target.name.upper(): target for target in declared.targets}
    written: dict[int, JointTarget] = {}
    for match in lists:
        if not any(start <= match.start() < end for start, end in relative):
            written[match.start()] = _take(program, match)
            known[(match[1] or "").upper()] = written[match.start()]
    moved = [match.span(2) for match in moves]
    for match in POSE.finditer(text):
        if match[1] or match[2] or any(start <= match.start() < end for start, end in moved):
            program.leave_pose(match.start(), match[1] or "a move", "a pose")
        else:
            program.leave(match.start(), "a pose")
    poses = {name.upper() for one in (program, declared) if one is not None for name, _ in one.poses}
    for match in moves:
        _follow(program, match, known, written, poses)
    inside = {found.end() for match in lists for found in LINE_END.finditer(text, *match.span())}
    program.left += not_kept(text, known, inside)


def _follow(
    program: Program,
    match: re.Match[str],
    known: dict[str, JointTarget],
    written: dict[int, JointTarget],
    poses: set[str],
) -> None:
    goal = match[2].split()[0].rstrip(",").upper()
    target = written.get(match.start(2)) if goal[0] == "{" else known.get(goal)
    if match[1].upper().endswith("_REL") or (goal[0] != "{" and target is None):
        why = "a pose" if goal in poses else "not an axis target of this file"
        where = " or of its .dat" if program.beside is not None and goal not in poses else ""
        program.leave(match.start(), f"{match[1]} {match[2].strip()[:40]}: {why}{where}")
    if target is not None or (goal[0] != "{" and goal not in poses):
        program.moves.append(target)


def _take(program: Program, match: re.Match[str]) -> JointTarget:
    parts = [AXIS.fullmatch(match[2], at.start(), at.end()) for at in re.finditer(r"[^,]+", match[2])]
    arm = [part for part in parts if part is not None and part[1].upper() == "A"]
    name, axes = match[1] or "axis target", [int(part[2]) for part in arm]
    if match[3] != "}" or None in parts or axes != [*range(1, len(arm) + 1)]:
        whole = match[3] == "}" and None not in parts
        what = f"{name} lacks axes: it has {axes}" if whole else f"{name} is not A1, A2, ... with numbers"
        raise program.refuse(match.start(), what, "Correct it, or export it again.")
    at = match.start(2)
    numbers = [(part[3], (at + part.start(3), at + part.end(3))) for part in arm]
    return program.add(name, numbers, line=line_at(program.text, match.start()))


DIALECT = Dialect(
    "KRL",
    (".src", ".dat"),
    sign(r"\{[^{}]{0,40}\bA1\s+[-+\d.]|\bE6(?:AXIS|POS)\s+\w+\s*(?:\[|=)"),
    find,
    "Store E6AXIS: $AXIS_ACT holds the joints where the arm stands",
    (r"^\s*DEFDAT\b", r"^\s*ENDDAT\b", "ENDDAT"),
    pair=(".src", ".dat"),
)
