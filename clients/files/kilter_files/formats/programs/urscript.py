"""Universal Robots' URScript: the joints and poses that it moves to, in place or by a variable; other moves are named."""

from __future__ import annotations

import math
import re
from collections.abc import Collection

from kilter_files.formats.programs.found import (
    NUMBER,
    Dialect,
    Mark,
    Program,
    blank_strings_and_comments,
    line_number,
    sign,
)
from kilter_files.formats.programs.krl_lines import Keyed
from kilter_files.formats.programs.one_target import JointTarget, Span
from kilter_files.formats.programs.poses.urscript import (
    BY_FORCE,
    CHANGED,
    Poses,
    calls_of_others,
    inside,
    inverse_arguments,
)

DECLARED = re.compile(r"^[ \t]*+(?:global[ \t]+|local[ \t]+)?(\w{1,64})[ \t]*+=[ \t]*+([^\r\n]*)", re.M)
MOVE = Keyed(
    "optimove move servo speed",
    r"\b((?:optimove|move|servo|speed)[jlpc])[ \t]{0,9}\(\s*+(?:\w{1,16}\s?=\s?)?(\[[^\]]{0,500}\]?|\w{1,64}\s?[(\[]?)?",
    0,
)
TO_JOINTS = frozenset(("movej", "movel", "movep"))  # along a line too the arm comes to these joints
POSE = re.compile(r"p\s?\[|get_inverse_kin\s?\(")
WHERE_IT_IS = re.compile(r"get_(?:actual|target)_joint_positions\s?\(")
CELL = re.compile(rf"(d2r\(\s?)?({NUMBER})(?(1)\s?\))")
SIX = re.compile(r"\[\s*+" + r"\s*+,\s*+".join([f"({NUMBER})"] * 6) + r"\s*+\]")  # as most lists are
PARAMETERS = re.compile(r"^[ \t]*+(?:def|thread)[ \t]+\w{1,64}[ \t]*+\(([^)\n]{1,500})\)", re.M)
TARGET = re.compile(rf"p?\s?\[\s*+{NUMBER}(?:\s*+,\s*+{NUMBER}){{5}}\s*+\]")
INNER = re.compile(r"\w{1,64}\s?\([^()]{0,500}\)")
WORDS = re.compile(r"(?<![\w.])\w+(?![\w(\[])")
ENDED = re.compile(r"\s*+(?:[,)]|\Z)")  # nothing is added to a list
MOST_RAD = 4.2 * math.pi

Places = dict[str, list[tuple[int, str]]]


def find(program: Program) -> None:
    """Find the joints and poses of moves.

    Raises:
        FileError: joints that are not numbers, or degrees.

    """
    text = blank_strings_and_comments(program.text, "#")
    declared = _assignments(text)
    lists = {name for name, places in declared.items() if all(written.startswith("[") for _, written in places)}
    given_poses = {name for name, places in declared.items() if any(written.startswith("p[") for _, written in places)}
    taken: dict[int, JointTarget | None] = {}
    named = set[str]()  # variables of which all values are taken
    forced, plain, near = set[JointTarget | None](), set[JointTarget | None](), 0
    poses = Poses(program, text, declared)
    for match in program.moves_found(MOVE.finditer(text)):
        goal = (match[2] or "").strip()
        written_out = goal.startswith("[")
        if written_out and not ENDED.match(text, match.end(2)):
            program.leave(match.start(), f"{match[1]}({goal[:40]}: its joints are computed")
            poses.last = None
            program.moves.append(None)
            continue
        if match[1] in TO_JOINTS and (written_out or goal in lists):
            if written_out:
                target = taken[match.start(2)] = _add_joint_target(program, match[1], match.start(2), goal)
            else:
                new = () if goal in named else declared[goal]
                taken |= {at: _add_joint_target(program, goal, at, written) for at, written in new}
                named.add(goal)
                target = taken[poses.assignment_before(goal, match.start())[0]]
            by_force = match.start() in poses.forced
            if by_force:
                program.leave(match.start(), f"{match[1]}({goal[:40]}: {BY_FORCE}")
            (forced if by_force else plain).add(target)
            sure = written_out or poses.is_sure(goal, match.start())
            poses.last = (match.start(), target) if target is not None and sure else None
            program.moves.append(target and target._replace(line=line_number(text, match.start())))
            if target is None and not written_out:
                program.leave(match.start(), f"{match[1]}({goal[:40]}: its joints are computed")
            continue
        hint, doubt = _hint(program, text, match, lists, poses)
        if not poses.add_move_poses(match, hint, doubt):
            program.leave(match.start(), f"{match[1]}({goal[:40]}: no target of this file")
            poses.last = None
        if hint is not None and match[1] == "movej":
            near += 1
            program.moves.append(hint)
        else:
            _name_other(program, match, goal, goal in given_poses)
    for match in CHANGED.finditer(text):
        if match[1] in named:
            program.leave(match.start(), f"{match[0].strip()[:40]}: changes joints to which a move goes")
    _name_calls(program, text, declared)
    poses.leave_beside_targets()
    program.leave_targets({one: f"{BY_FORCE} in all moves to it" for one in forced - plain if one is not None})
    if poses.displaced and program.targets:
        program.warn("the program displaces moves to joints too (path offset, conveyor)")
    if near:
        program.list_warnings.append(
            f"{near} moves to a pose count with the joints of their qnear: where the waypoint was taught"
        )


def _assignments(text: str) -> Places:
    """What a program assigns to its variables; what a subprogram is given is not known in it."""
    declared: Places = {}
    for match in DECLARED.finditer(text):
        declared.setdefault(match[1], []).append((match.start(2), match[2].rstrip()))
    for match in PARAMETERS.finditer(text):
        for name in re.findall(r"\w+", match[1]):
            declared.pop(name, None)
    return declared


def _name_other(program: Program, match: re.Match[str], goal: str, given_pose: bool) -> None:
    """Name a move that has no joints: a pose, a move along a line or arc, or a variable that nobody sets."""
    line = line_number(program.text, match.start())
    if match[1] in ("movel", "movep", "movec"):
        program.poses.append(("a move along a line or arc", line))
    elif match[1] == "movej" and (POSE.fullmatch(goal) or given_pose):
        program.poses.append(("movej" if POSE.fullmatch(goal) else goal, line))
    elif match[1] == "movej":
        what = f"movej goes to {goal!r}, to which this program assigns no joints"
        program.unknown.append((line, what, f"Write {goal} = [...] before it, or the joints instead."))


def _hint(
    program: Program, text: str, match: re.Match[str], lists: Collection[str], poses: Poses
) -> tuple[JointTarget | None, str]:
    """The joints beside which a pose is looked for, which are never rewritten; and what is not known of how it is."""
    stated = inverse_arguments(text, match.start(2)) if match[2] else {}
    at, tool = stated.get("tcp", (0, ""))
    if "tcp" in stated and (tool or program.text[at : at + 12] != '"active_tcp"'):
        return None, f"its inverse is that of another tool, {tool[:40]}"
    at, said = stated.get("qnear", (0, ""))
    if not said or WHERE_IT_IS.match(said):
        return None, ""
    written = said
    if not said.startswith("["):
        if said not in lists:
            return None, f"its qnear is not known, {said[:40]}"
        if not poses.is_sure(said, match.start()):
            return None, f"its qnear {said[:40]} depends on the way that the program took"
        at, written = poses.assignment_before(said, match.start())
    numbers, radians = _numbers(program.text, at, written)
    if not numbers:
        what = f"qnear is {written[:40]!r}, no list of numbers"
        program.unknown.append((line_number(text, match.start()), what, "Write the joints in rad."))
        return None, f"its {what}"
    joints = [math.degrees(float(n)) if turn else float(n) for (n, _), turn in zip(numbers, radians, strict=True)]
    name = "movej" if said.startswith("[") else said
    return JointTarget(name, line_number(text, match.start()), tuple(joints)), ""


def _name_calls(program: Program, text: str, declared: Places) -> None:
    """Name the calls that hand a target on: to a subprogram, or to a function that may move the arm."""
    targets = {name for name, places in declared.items() if any(TARGET.match(written) for _, written in places)}
    read = 0  # up to where calls that are closed nowhere near were read
    for match in calls_of_others(text):
        said = inside(text, match.end())
        end = match.end() + len(said)
        if text[end : end + 1] not in (")", "]"):
            if match.end() < read:
                continue
            read = end
        bare = INNER.sub("", said) if targets or "[" in said else ""
        if (TARGET.search(bare) or targets.intersection(WORDS.findall(bare))) and not MOVE.match(text, match.start()):
            program.leave(match.start(), f"{match[1]}({said[:40]}: {match[1]} is given a target")


def _add_joint_target(program: Program, name: str, at: int, written: str) -> JointTarget | None:
    numbers, radians = _numbers(program.text, at, written)
    if not numbers:
        what = f"{name} goes to {written[:40]!r}, no list of numbers"
        program.leave(at, what)
        program.unknown.append((line_number(program.text, at), what, "Write the joints in rad."))
        return None
    if any(turn and abs(float(number)) > MOST_RAD for (number, _), turn in zip(numbers, radians, strict=True)):
        raise program.refuse(at, f"{name} moves by more than two turns: are these degrees", "Give radians.")
    return program.add(name, numbers, radians)


def _numbers(text: str, start: int, written: str) -> tuple[list[tuple[str, Span]], list[bool]]:
    """The numbers of a list with their places, and which of them are radians; none when something else is among them."""
    plain = SIX.fullmatch(text, start, start + len(written))
    if plain is not None:
        return [*zip(plain.groups(), plain.regs[1:], strict=True)], [True] * 6
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
    (".script", ".urscript"),
    sign(r"\bmovej\s*+\("),
    find,
    "Give movej joints: get_actual_joint_positions() reads them",
    ordered=True,
    mark=Mark("# {said}", re.compile(r"[ \t]*+end\b")),
)
