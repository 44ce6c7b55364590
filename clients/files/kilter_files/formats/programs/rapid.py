"""ABB's RAPID: jointtargets and robtargets, declared or written into a move; external axes stay."""

from __future__ import annotations

import re

from kilter_files.formats.programs.found import (
    DATA,
    Dialect,
    Mark,
    Program,
    blank_strings_and_comments,
    line_number,
    sign,
)
from kilter_files.formats.programs.krl_lines import Keyed, has_word
from kilter_files.formats.programs.one_target import UNUSED, Spans
from kilter_files.formats.programs.rapid_moves import MOVE, PAIR, TO_POSES, Known, Poses, RapidMoves, take_joints
from kilter_files.formats.programs.rapid_uses import (
    AXIS_LOCKED,
    DISPLACED,
    TARGET,
    UNUSED_AXIS,
    declared_again,
    elements,
    is_assigned,
    other_uses,
    parse_pose_target,
    variable_changes,
)
from kilter_files.formats.programs.rapid_uses import DECLARED as POSE

DECLARED = Keyed(
    "jointtarget", r"\bjointtarget\s+(\w+)\s*+(\{[\w,\s]*\})?\s*+:=((?:[^;:]|:(?!=)){0,200000}+)(;|(?=:=)|\Z)"
)
SEVERAL_TIMES = "it is declared several times"
PART_READ = re.compile(r"(?<![\\.\w])(\w+)\s*+(?:\{[^}\n]{0,40}\}\s*+)?\.\s*+robax\b", re.I)
EXTERNAL = re.compile(r"\.\s*+extax\b", re.I)
CONSTANT = Keyed("const", r"\bCONST\s+robtarget\s+(\w+)")
HOLDS_TARGETS = Keyed("robtarget jointtarget", r"\b(?:rob|joint)target\s+\w+\s*+(?:\{[\w,\s]*\})?\s*+:=[^;]{0,200000}")
COMPUTED = re.compile(r"[A-Za-z_]\w{2,}")
BY_ITSELF = Keyed(
    "ind egm stepbwdpath loadid",
    r"(?<![\\.\w])(Ind[ACDR]Move|EGMRun(?:Joint|Pose)|EGMMove[LC]|StepBwdPath|LoadId)(?=[\s\\])",
)


def find(program: Program) -> None:
    """Find the targets.

    Raises:
        FileError: one that is not made of six joints and six external axes.

    """
    text = blank_strings_and_comments(program.text, "!")
    known: Known = {}
    for match in DECLARED.finditer(text):
        pairs = [*PAIR.finditer(text, match.start(3), match.end(3))]
        if any(max(abs(float(value)) for value in pair.groups()[:6]) > UNUSED_AXIS for pair in pairs):
            program.leave(match.start(), f"{match[1]}, a jointtarget without the robot's joints")
            continue
        if not pairs and match[4] == ";" and COMPUTED.search(match[3]):
            what = f"{match[1]}, a jointtarget that the program computes"
            program.leave(match.start(), what)
            program.unknown.append((line_number(text, match.start()), what, "Write its joints."))
            continue
        if not pairs or match[4] != ";" or PAIR.sub("", match[3]).strip(" \t\r\n[],"):
            what = f"{match[1]} is not made of six joints and six external axes, [[...],[...]]"
            raise program.refuse(match.start(), what, "Correct the target.")
        names = elements(match[1], match[2], len(pairs))
        known[match[1].lower()] = {
            name.lower(): take_joints(program, name, pair) for name, pair in zip(names, pairs, strict=True)
        }
    poses = _poses(program, text)
    moves = RapidMoves(program, text, known, poses, {match[1].lower() for match in variable_changes(text)})
    left = [match.span() for match in program.moves_found(MOVE.finditer(text)) if not moves.add_move(match)]
    for match in BY_ITSELF.finditer(text):
        program.leave(match.start(), f"{match[1]}: moves the arm otherwise than to a target")
    # one from which moves only compute others is not a goal itself
    origins = {one.computed.of for one in program.cartesian if one.computed is not None}
    program.cartesian = [pose for pose in program.cartesian if pose.uses or pose not in origins]
    _note_problems(text, program, poses)
    data = _note_other_uses(text, program, poses, known, moves.understood, Spans(left))
    data |= {match[1].lower() for match in (PART_READ.finditer(text) if has_word(text, "robax") else ())} - {
        match[1].lower() for match in variable_changes(text)
    }
    program.leave_targets({one: DATA for name in data - moves.moved for one in known.get(name, {}).values()})


def _poses(program: Program, text: str) -> Poses:
    """The declared robtargets by name: arrays have several."""
    poses: Poses = {}
    for match in POSE.finditer(text):
        found = [*TARGET.finditer(text, match.start(3), match.end(3))]
        if not found or TARGET.sub("", match[3]).strip(" \t\r\n[],"):
            program.leave_pose(match.start(), match[1], f"{match[1]}, a robtarget without numbers")
            continue
        names = elements(match[1], match[2], len(found))
        for earlier in poses.get(match[1].lower(), {}).values():
            earlier.problem = SEVERAL_TIMES
        poses[match[1].lower()] = {
            name.lower(): program.add_pose(parse_pose_target(program, name, one))
            for name, one in zip(names, found, strict=True)
        }
    return poses


def _note_problems(text: str, program: Program, poses: Poses) -> None:
    """Note what the text says of robtargets beside the moves to them."""
    if DISPLACED.search(text):
        for pose in program.cartesian:
            pose.problem = pose.problem or "the program displaces it (PDisp, EOffs)"
    for name in {match[1].lower() for match in variable_changes(text)}:
        for pose in poses.get(name, {}).values():
            pose.problem = pose.problem or "the program changes it"
    locked = AXIS_LOCKED.search(text) is not None
    for pose in program.cartesian:
        if locked and any(use.straight for use in pose.uses):
            pose.problem = pose.problem or "its orientation is not kept (SingArea \\LockAxis4)"


def _note_other_uses(
    text: str, program: Program, poses: Poses, known: Known, understood: set[int], left: Spans
) -> set[str]:
    """Name what uses targets otherwise than as the goals of moves; ``left`` are moves that are named already.

    Returns:
        The names that are handed to what may do with them anything, but for routines of the file that take values.

    """
    again = [*declared_again(text, poses.keys() | known.keys())]
    for match in again:
        program.leave(match.start(), f"{match[1]}: declared several times")
    for name in {match[1].lower() for match in again}:
        for pose in poses.get(name, {}).values():
            pose.problem = SEVERAL_TIMES
    for match in variable_changes(text):
        if match[1].lower() in known and not EXTERNAL.search(match[0]):
            program.leave(match.start(), f"{match[1]}: the program changes this jointtarget")
    constant = {match[1].lower() for match in CONSTANT.finditer(text)}
    data: set[str] = set()
    noted = set[tuple[str, bool]]()
    for use in other_uses(text, poses.keys() | known.keys(), understood):
        name, by = use.name.lower(), use.handed_to
        data |= {name} if by else set()
        if use.at not in left:
            program.leave(
                use.at, f"{use.name}: used{f' by {by}' if by else ''} otherwise than as the goal of a known move"
            )
        given, may_change = f"{by} is given it, and may move to it in other frames", bool(by) and name not in constant
        elsewhere = (
            given if by else f"line {line_number(text, use.at)} uses it otherwise than as the goal of a known move"
        )
        news = (name, may_change) not in noted and not TO_POSES.fullmatch(by)
        for pose in poses.get(name, {}).values() if news else ():
            pose.unused = elsewhere if pose.unused == UNUSED else pose.unused
            pose.problem = pose.problem or (f"{by} may change it" if may_change else "")
        noted |= {(name, may_change)} if news else set()
    own = Spans([match.span() for match in HOLDS_TARGETS.finditer(text)])
    for written in (*TARGET.finditer(text), *PAIR.finditer(text)):
        at = written.start()
        if not (at in understood or at in own or at in left or is_assigned(text, at)):
            program.leave(at, f"{written[0][:40]}: the goal of no known move")
    return data


DIALECT = Dialect(
    "RAPID",
    (".mod", ".modx", ".sys", ".sysx", ".prg"),
    sign(r"\bjointtarget\b|\bMoveAbsJ\b|\brobtarget\b\s+\w+\s*+(?:\{[\w,\s]*\})?\s*+:="),
    find,
    "Store jointtargets: CJointT() reads the joints where the arm stands",
    (r"^[ \t]*+MODULE\b", r"^[ \t]*+ENDMODULE\b", "ENDMODULE"),
    mark=Mark("  ! {said}", re.compile(r"\s*+ENDMODULE\b", re.I)),
)
