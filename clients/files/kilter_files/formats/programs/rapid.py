"""ABB's RAPID: jointtargets and robtargets, declared or written into a move; external axes stay."""

from __future__ import annotations

import re

from kilter_files.formats.programs.found import (
    DATA,
    EXTERNAL_AXES,
    NUMBER,
    Dialect,
    Mark,
    Program,
    blanked,
    line_at,
    sign,
)
from kilter_files.formats.programs.one_target import JointTarget, PoseTarget, Spans, Use
from kilter_files.formats.programs.poses.rapid import (
    AXIS_LOCKED,
    CONFIGURATION_OFF,
    DISPLACED,
    TARGET,
    RapidFrames,
    arguments,
    pose_of,
)
from kilter_files.formats.programs.poses.rapid import DECLARED as POSE
from kilter_files.formats.programs.poses.rapid_computed import CALL, Computed
from kilter_files.formats.programs.rapid_uses import changed, declared_again, elements, is_assigned, other_uses

UNUSED_AXIS = 8e9  # 9E9 stands for an external axis that is not there
SIX = r"\[\s*" + r"\s*,\s*".join([f"({NUMBER})"] * 6) + r"\s*\]"
PAIR = re.compile(rf"\[\s*{SIX}\s*,\s*{SIX}\s*\]")
DECLARED = re.compile(r"\bjointtarget\s+(\w+)\s*(\{[\w,\s]*\})?\s*:=([^;]{0,200000})(;|\Z)", re.I)
MOVE = re.compile(
    r"\b(Move\w{1,20}|Arc[LC]\d?(?:Start|End)?|Trigg[LJC]|Search[LC])(?=[\s\\])\s*([^;]{0,2000})(;|\Z)", re.I
)
TO_POSES = re.compile(r"(?:Move|Trigg|Arc)([JLC])(?:DO|AO|GO|Sync|\d?(?:Start|End))?\d?", re.I)
TO_TOOL = {"M": 2, "T": 3, "A": 4}  # arguments between goals and tool: speed and zone, a trigger, seam and weld
CONFIGURATION_IS_OFF = (
    "the program switches its configuration off: write ConfJ \\On and ConfL \\On, if its confdata is right"
)
SEVERAL_TIMES = "it is declared several times"
PART_READ = re.compile(r"(?<![\\.\w])(\w+)\s*(?:\{[^}\n]{0,40}\}\s*)?\.\s*robax\b", re.I)
EXTERNAL = re.compile(r"\.\s*extax\b", re.I)
CONSTANT = re.compile(r"\bCONST\s+robtarget\s+(\w+)", re.I)
HOLDS_TARGETS = re.compile(r"\b(?:rob|joint)target\s+\w+\s*(?:\{[\w,\s]*\})?\s*:=[^;]{0,200000}", re.I)
COMPUTED = re.compile(r"[A-Za-z_]\w{2,}")
BY_ITSELF = re.compile(
    r"(?<![\\.\w])(Ind[ACDR]Move|EGMRun(?:Joint|Pose)|EGMMove[LC]|StepBwdPath|LoadId)(?=[\s\\])", re.I
)
SENSED = re.compile(r"\\\s*(?:Corr\b|Track\s*:=)", re.I)
INDEX = r"\{\s*\d+\s*(?:,\s*\d+\s*){0,2}\}"
WRITTEN = re.compile(rf"\w+(?:\s*{INDEX})?|\[.*\]", re.S)
WITH = re.compile(r"(\w+)\s*((?:\\[^\\]{1,80})*)")
WORK_OBJECT = re.compile(r"\\\s*WObj\b\s*(?::=\s*(\w+)\s*(?=\\|$))?", re.I)
GOAL = re.compile(rf"(\w+)\s*({INDEX}|\{{[^}}]{{0,80}}\}})?\s*(?:\\.*)?", re.S)

# by the name of the variable, and there by that of the element, both in small letters
Known = dict[str, dict[str, JointTarget]]
Poses = dict[str, dict[str, PoseTarget]]


def find(program: Program) -> None:
    """Find the targets.

    Raises:
        FileError: one that is not made of six joints and six external axes.

    """
    text = blanked(program.text, "!")
    known: Known = {}
    for match in DECLARED.finditer(text):
        pairs = [*PAIR.finditer(text, match.start(3), match.end(3))]
        if any(max(abs(float(value)) for value in pair.groups()[:6]) > UNUSED_AXIS for pair in pairs):
            program.leave(match.start(), f"{match[1]}, a jointtarget without the robot's joints")
            continue
        if not pairs and match[4] == ";" and COMPUTED.search(match[3]):
            what = f"{match[1]}, a jointtarget that the program computes"
            program.leave(match.start(), what)
            program.unknown.append((line_at(text, match.start()), what, "Write its joints."))
            continue
        if not pairs or match[4] != ";" or PAIR.sub("", match[3]).strip(" \t\r\n[],"):
            what = f"{match[1]} is not made of six joints and six external axes, [[...],[...]]"
            raise program.refuse(match.start(), what, "Correct the target.")
        names = elements(match[1], match[2], len(pairs))
        known[match[1].lower()] = {
            name.lower(): _take(program, name, pair) for name, pair in zip(names, pairs, strict=True)
        }
    poses = _poses(program, text)
    frames = RapidFrames(text, program.stated)
    goals: set[int] = set()
    computed = Computed(program, text, lambda said: _declared(said, poses))
    moved: set[str] = set()
    left = [
        match.span()
        for match in MOVE.finditer(text)
        if not _to_poses(program, text, match, poses, frames, goals, computed)
        and not _follow(program, text, match, known, goals, moved)
    ]
    for match in BY_ITSELF.finditer(text):
        program.leave(match.start(), f"{match[1]}: moves the arm otherwise than to a target")
    goals |= computed.named
    # one from which moves only compute others is not a goal itself
    origins = {one.computed.of for one in program.cartesian if one.computed is not None}
    program.cartesian = [pose for pose in program.cartesian if pose.uses or pose not in origins]
    _note_problems(text, program, poses)
    data = _note_other_uses(text, program, poses, known, goals, Spans(left))
    data |= {match[1].lower() for match in PART_READ.finditer(text)} - {match[1].lower() for match in changed(text)}
    program.leave_targets({one: DATA for name in data - moved for one in known.get(name, {}).values()})


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
            name.lower(): program.add_pose(pose_of(program, name, one)) for name, one in zip(names, found, strict=True)
        }
    return poses


def _to_poses(
    program: Program,
    text: str,
    match: re.Match[str],
    poses: Poses,
    frames: RapidFrames,
    understood: set[int],
    computed: Computed,
) -> bool:
    """Take the robtargets of a move as moves to them, and note their places; whether all of its goals are such."""
    way = TO_POSES.fullmatch(match[1])
    if way is None:
        return False
    said = [(match.start(2) + at, one) for at, one in arguments(match[2]) if not one.startswith("\\")]
    count = 2 if way[1].upper() == "C" else 1
    with_tool = count + TO_TOOL[match[1][0].upper()]
    goals = [_goal(program, text, match[1], at, one, poses, computed) for at, one in said[:count]]
    if len(said) <= with_tool or None in goals:
        return False
    held = WITH.fullmatch(said[with_tool][1])
    work = WORK_OBJECT.search(held[2]) if held else None
    base = "its work object is not understood" if work and not work[1] else frames.base(work[1] if work else "wobj0")
    tool = frames.tool(held[1]) if held else "its tool is not understood"
    understood.update(at for at, _ in said[:count])
    if SENSED.search(match[2]):
        program.leave(match.start(), f"{match[1]} {said[0][1][:40]}: a sensor moves it beside its target")
        for goal in goals:
            assert goal is not None
            goal.unused = "the moves to it add what a sensor says (\\Corr, \\Track)"
        return True
    for goal in goals:
        assert goal is not None
        goal.uses.append(Use(base, tool, straight=way[1].upper() != "J"))
        line = line_at(text, match.start())
        program.moves_to_poses.append((line, f"{match[1]} {said[0][1][:40]}", goal))
    return True


def _goal(
    program: Program, text: str, move: str, at: int, said: str, poses: Poses, computed: Computed
) -> PoseTarget | None:
    said = re.sub(r"\\\s*ID\s*:=.*", "", said).strip()
    if CALL.fullmatch(said):
        return computed.take(at, said)
    if not WRITTEN.fullmatch(said):
        for pose in poses.get(said.partition("{")[0].strip().lower(), {}).values():
            pose.problem = pose.problem or "a move to it has a computed index"
        return None
    if said[0] == "[":
        written = TARGET.match(text, at)
        return program.add_pose(pose_of(program, move, written), counted=False) if written else None
    return _declared(said, poses)


def _declared(said: str, poses: Poses) -> PoseTarget | None:
    """The declared robtarget of this name, or element of an array."""
    said = "".join(said.lower().split())
    return poses.get(said.partition("{")[0], {}).get(said)


def _note_problems(text: str, program: Program, poses: Poses) -> None:
    """Note what the text says of robtargets beside the moves to them."""
    if DISPLACED.search(text):
        for pose in program.cartesian:
            pose.problem = pose.problem or "the program displaces it (PDisp, EOffs)"
    for match in changed(text):
        for pose in poses.get(match[1].lower(), {}).values():
            pose.problem = pose.problem or "the program changes it"
    off = {match[1].upper() == "L" for match in CONFIGURATION_OFF.finditer(text)}
    locked = AXIS_LOCKED.search(text) is not None
    for pose in program.cartesian:
        if any(use.straight in off for use in pose.uses):
            pose.problem = pose.problem or CONFIGURATION_IS_OFF
        if locked and any(use.straight for use in pose.uses):
            pose.problem = pose.problem or "its orientation is not kept (SingArea \\LockAxis4)"


def _note_other_uses(
    text: str, program: Program, poses: Poses, known: Known, understood: set[int], left: Spans
) -> set[str]:
    """Name what uses targets otherwise than as the goals of moves; ``left`` are moves that are named already.

    Returns:
        The names that are handed to what may do with them anything, but for routines of the file that take values.

    """
    for match in declared_again(text, poses.keys() | known.keys()):
        program.leave(match.start(), f"{match[1]}: declared several times")
        for pose in poses.get(match[1].lower(), {}).values():
            pose.problem = SEVERAL_TIMES
    for match in changed(text):
        if match[1].lower() in known and not EXTERNAL.search(match[0]):
            program.leave(match.start(), f"{match[1]}: the program changes this jointtarget")
    constant = {match[1].lower() for match in CONSTANT.finditer(text)}
    data: set[str] = set()
    for use in other_uses(text, poses.keys() | known.keys(), understood):
        name, by = use.name.lower(), use.handed_to
        data |= {name} if by else set()
        if use.at not in left:
            program.leave(
                use.at, f"{use.name}: used{f' by {by}' if by else ''} otherwise than as the goal of a known move"
            )
        if by and name not in constant and not TO_POSES.fullmatch(by):
            for pose in poses.get(name, {}).values():
                pose.problem = pose.problem or f"{by} may change it"
    own = Spans([match.span() for match in HOLDS_TARGETS.finditer(text)])
    for written in (*TARGET.finditer(text), *PAIR.finditer(text)):
        at = written.start()
        if not (at in understood or at in own or at in left or is_assigned(text, at)):
            program.leave(at, f"{written[0][:40]}: the goal of no known move")
    return data


def _follow(
    program: Program, text: str, match: re.Match[str], known: Known, understood: set[int], moved: set[str]
) -> bool:
    """Take the joints of a move, and note their place and name, or name its line; whether they are known."""
    joints = match[1].lower() == "moveabsj"
    at, said = next(((at, one) for at, one in arguments(match[2]) if not one.startswith("\\")), (0, ""))
    at += match.start(2)
    written = PAIR.match(text, at) if joints else None
    goal = GOAL.fullmatch(said)
    targets = known.get(goal[1].lower(), {}) if joints and goal is not None else {}
    if written is not None:
        program.moves.append(_take(program, match[1], written))
    elif goal is not None and targets:
        moved.add(goal[1].lower())
        program.moves.append(targets.get("".join(f"{goal[1]}{goal[2] or ''}".lower().split())))
    else:
        program.leave(match.start(), f"{match[1]} {said[:40]}: no target of this file")
        program.moves += [None] if joints else []
        return False
    understood.add(at)
    return True


def _take(program: Program, name: str, pair: re.Match[str]) -> JointTarget:
    if any(abs(value) < UNUSED_AXIS and value != 0 for value in map(float, pair.groups()[6:])):
        program.warn(EXTERNAL_AXES)
    numbers = [(pair[k], pair.span(k)) for k in range(1, 7)]
    return program.add(name, numbers, line=line_at(program.text, pair.start()))


DIALECT = Dialect(
    "RAPID",
    (".mod", ".modx", ".sys", ".sysx", ".prg"),
    sign(r"\bjointtarget\b|\bMoveAbsJ\b|\brobtarget\b\s+\w+\s*(?:\{[\w,\s]*\})?\s*:="),
    find,
    "Store jointtargets: CJointT() reads the joints where the arm stands",
    (r"^\s*MODULE\b", r"^\s*ENDMODULE\b", "ENDMODULE"),
    mark=Mark("  ! {said}", re.compile(r"\s*ENDMODULE\b", re.I)),
)
