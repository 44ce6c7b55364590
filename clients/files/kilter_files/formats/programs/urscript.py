"""Universal Robots' URScript: the joints and poses that it moves to, in place or by a variable; other moves are named."""

from __future__ import annotations

import math
import re
from dataclasses import replace

from kilter_files.formats.programs.found import NUMBER, Dialect, Mark, Program, blanked, line_at, sign
from kilter_files.formats.programs.one_target import JointTarget, Span
from kilter_files.formats.programs.poses.urscript import Poses

DECLARED = re.compile(r"^[ \t]*(?:global[ \t]+|local[ \t]+)?(\w{1,64})[ \t]*=[ \t]*([^\r\n]*)", re.M)
MOVE = re.compile(r"\b((?:move|servo|speed)[jlpc])\s?\(\s*(\[[^\]]{0,500}\]?|\w{1,64}\s?[(\[]?)?")
INVERSE = re.compile(r"get_inverse_kin\s?\(([^)]{0,500})\)")
POSE = re.compile(r"p\s?\[|get_inverse_kin\s?\(")
NEAR = re.compile(r"\bqnear\s?=\s?(?:(\w{1,64})|(\[[^\]]{0,500}\]))")
CELL = re.compile(rf"(d2r\(\s?)?({NUMBER})(?(1)\s?\))")
MOST_RAD = 4.2 * math.pi

Places = dict[str, list[tuple[int, str]]]


def find(program: Program) -> None:
    """Find the joints and poses of moves.

    Raises:
        FileError: joints that are not numbers, or degrees.

    """
    text = blanked(program.text, "#")
    declared: Places = {}
    for match in DECLARED.finditer(text):
        declared.setdefault(match[1], []).append((match.start(2), match[2].rstrip()))
    taken: dict[int, JointTarget] = {}
    near = 0
    poses = Poses(program, text, declared)
    for match in MOVE.finditer(text):
        goal = (match[2] or "").strip()
        places = [(match.start(2), goal)] if goal.startswith("[") else declared.get(goal, [])
        if match[1] == "movej" and places and all(written.startswith("[") for _, written in places):
            for at, written in places:
                taken.setdefault(at, _take(program, "movej" if goal.startswith("[") else goal, at, written))
            poses.last = (match.start(), taken[_before(match.start(), places)])
            program.moves.append(replace(poses.last[1], line=line_at(text, match.start())))
            continue
        hint = _hint(program, text, match, declared) if match[1] == "movej" else None
        if not poses.take(match, hint):
            program.leave(match.start(), f"{match[1]}({goal[:40]}: no target of this file")
            poses.last = None
        near += hint is not None
        program.moves += [] if hint is None else [hint]
        if hint is None:
            _name_other(program, match, goal, places)
    if near:
        program.warnings.append(
            f"{near} moves to a pose count with the joints of their qnear: where the waypoint was taught"
        )


def _before(at: int, places: list[tuple[int, str]]) -> int:
    """The assignment that holds at a place: the last one before it."""
    starts = [start for start, _ in places]
    return max((start for start in starts if start <= at), default=starts[-1]) if len(starts) > 1 else starts[0]


def _name_other(program: Program, match: re.Match[str], goal: str, places: list[tuple[int, str]]) -> None:
    """Name a move that has no joints: a pose, a move along a line or arc, or a variable that nobody sets."""
    line = line_at(program.text, match.start())
    if match[1] in ("movel", "movep", "movec"):
        program.poses.append(("a move along a line or arc", line))
    elif match[1] == "movej" and (POSE.fullmatch(goal) or any(written.startswith("p[") for _, written in places)):
        program.poses.append(("movej" if POSE.fullmatch(goal) else goal, line))
    elif match[1] == "movej":
        what = f"movej goes to {goal!r}, to which this program assigns no joints"
        program.unknown.append((line, what, f"Write {goal} = [...] before it, or the joints instead."))


def _hint(program: Program, text: str, match: re.Match[str], declared: Places) -> JointTarget | None:
    """The joints beside which a pose is looked for; they are never rewritten."""
    inverse = INVERSE.match(text, match.start(2)) if match[2] else None
    near = None if inverse is None else NEAR.search(text, *inverse.span(1))
    if near is None:
        return None
    places = [(near.start(2), near[2])] if near[2] else declared.get(near[1], [])
    if not places or not all(written.startswith("[") for _, written in places):
        return None
    at = _before(match.start(), places)
    numbers, radians = _numbers(program.text, at, dict(places)[at])
    if not numbers:
        what = f"qnear is {dict(places)[at][:40]!r}, no list of numbers"
        program.unknown.append((line_at(text, match.start()), what, "Write the joints in rad."))
        return None
    joints = [math.degrees(float(n)) if turn else float(n) for (n, _), turn in zip(numbers, radians, strict=True)]
    return JointTarget(near[1] or "movej", line_at(text, match.start()), tuple(joints))


def _take(program: Program, name: str, at: int, written: str) -> JointTarget:
    numbers, radians = _numbers(program.text, at, written)
    if not numbers:
        raise program.refuse(at, f"{name} goes to {written[:40]!r}, no list of numbers", "Write the joints in rad.")
    if any(turn and abs(float(number)) > MOST_RAD for (number, _), turn in zip(numbers, radians, strict=True)):
        raise program.refuse(at, f"{name} moves by more than two turns: are these degrees", "Give radians.")
    return program.add(name, numbers, radians)


def _numbers(text: str, start: int, written: str) -> tuple[list[tuple[str, Span]], list[bool]]:
    """The numbers of a list with their places, and which of them are radians; none when something else is among them."""
    found: list[tuple[str, Span]] = []
    radians: list[bool] = []
    if not written.endswith("]"):
        return [], []
    at = start + 1
    for cell in text[at : start + len(written) - 1].split(","):
        match = CELL.fullmatch(cell.strip())
        if match is None:
            return [], []
        first = at + cell.index(cell.strip()) + match.start(2)
        found.append((match[2], (first, first + len(match[2]))))
        radians.append(match[1] is None)
        at += len(cell) + 1
    return found, radians


DIALECT = Dialect(
    "URScript",
    (".script",),
    sign(r"\bmovej\s*\("),
    find,
    "Give movej joints: get_actual_joint_positions() reads them",
    ordered=True,
    mark=Mark("# {said}", re.compile(r"[ \t]*end\b")),
)
