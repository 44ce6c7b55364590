"""ABB's RAPID: jointtargets and robtargets, declared or written into a move; external axes stay."""

from __future__ import annotations

import re

from kilter_files.formats.programs.found import NUMBER, Dialect, Mark, Program, blanked, line_at, sign
from kilter_files.formats.programs.one_target import JointTarget, PoseTarget, Use
from kilter_files.formats.programs.poses.rapid import (
    CHANGED,
    CONFIGURATION_OFF,
    DISPLACED,
    TARGET,
    RapidFrames,
    arguments,
    pose_of,
)
from kilter_files.formats.programs.poses.rapid import DECLARED as POSE

UNUSED_AXIS = 8e9  # 9E9 stands for an external axis that is not there
SIX = r"\[\s*" + r"\s*,\s*".join([f"({NUMBER})"] * 6) + r"\s*\]"
PAIR = re.compile(rf"\[\s*{SIX}\s*,\s*{SIX}\s*\]")
DECLARED = re.compile(r"\bjointtarget\s+(\w+)\s*(?:\{[\d,\s]*\})?\s*:=([^;]{0,200000})(;|\Z)", re.I)
MOVE = re.compile(r"\b(Move\w{1,20}|TriggL|TriggJ|TriggC|SearchL|SearchC)(?=[\s\\])\s*([^;]{0,2000})(;|\Z)", re.I)
TO_POSES = re.compile(r"(?:Move|Trigg)([JLC])(?:DO|AO|GO|Sync)?", re.I)
WRITTEN = re.compile(r"\w+(?:\s*\{\s*\d+\s*\})?|\[.*\]", re.S)
WITH = re.compile(r"(\w+)\s*((?:\\[^\\]{1,80})*)")
WORK_OBJECT = re.compile(r"\\\s*WObj\s*:=\s*(\w+)", re.I)
GOAL = re.compile(r"(\w+)(?:\s*\{\s*(\d*)[^}]{0,80}\})?\s*[\\,]")

Known = dict[str, list[JointTarget]]
Poses = dict[str, list[PoseTarget]]


def find(program: Program) -> None:
    """Find the targets.

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
    poses = _poses(program, text)
    frames = RapidFrames(text, program.stated)
    for match in MOVE.finditer(text):
        if not _to_poses(program, text, match, poses, frames):
            _follow(program, text, match, known)
    _note_problems(text, program, poses)


def _poses(program: Program, text: str) -> Poses:
    """The declared robtargets by name, each a list: arrays have several."""
    poses: Poses = {}
    for match in POSE.finditer(text):
        found = [*TARGET.finditer(text, match.start(2), match.end(2))]
        if not found or TARGET.sub("", match[2]).strip(" \t\r\n[],"):
            program.leave_pose(match.start(), match[1], f"{match[1]}, a robtarget without numbers")
            continue
        names = [match[1]] if len(found) == 1 else [f"{match[1]}{{{k}}}" for k in range(1, len(found) + 1)]
        poses[match[1].lower()] = [
            program.add_pose(pose_of(program, name, one)) for name, one in zip(names, found, strict=True)
        ]
    return poses


def _to_poses(program: Program, text: str, match: re.Match[str], poses: Poses, frames: RapidFrames) -> bool:
    """Take the robtargets of a move as moves to them; whether all of its goals are such."""
    way = TO_POSES.fullmatch(match[1])
    if way is None:
        return False
    said = [(match.start(2) + at, one) for at, one in arguments(match[2]) if not one.startswith("\\")]
    count = 2 if way[1].upper() == "C" else 1
    with_tool = count + 2 + match[1].upper().startswith("TRIGG")
    goals = [_goal(program, text, match[1], at, one, poses) for at, one in said[:count]]
    if len(said) <= with_tool or None in goals:
        return False
    held = WITH.match(said[with_tool][1])
    work = WORK_OBJECT.search(held[2]) if held else None
    base = frames.base(work[1] if work else "wobj0")
    tool = frames.tool(held[1]) if held else "its tool is not understood"
    for goal in goals:
        assert goal is not None
        goal.uses.append(Use(base, tool, straight=way[1].upper() != "J"))
        line = line_at(text, match.start())
        program.moves_to_poses.append((line, f"{match[1]} {match[2].split(',')[0].strip()[:40]}", goal))
    return True


def _goal(program: Program, text: str, move: str, at: int, said: str, poses: Poses) -> PoseTarget | None:
    said = re.sub(r"\\\s*ID\s*:=.*", "", said).strip()
    if not WRITTEN.fullmatch(said):
        for pose in poses.get(said.partition("{")[0].strip().lower(), ()):
            pose.problem = pose.problem or "a move to it has a computed index"
        return None
    if said[0] == "[":
        written = TARGET.match(text, at)
        return program.add_pose(pose_of(program, move, written), counted=False) if written else None
    name, _, index = said.rstrip("} \t\r\n").partition("{")
    found = poses.get(name.strip().lower(), [])
    k = int(index or 1) - 1
    return found[k] if 0 <= k < len(found) and (index or len(found) == 1) else None


def _note_problems(text: str, program: Program, poses: Poses) -> None:
    """Note what the text says of robtargets beside the moves to them."""
    if DISPLACED.search(text):
        for pose in program.cartesian:
            pose.problem = pose.problem or "the program displaces it (PDisp, EOffs)"
    for match in CHANGED.finditer(text):
        for pose in poses.get(match[1].lower(), ()):
            pose.problem = pose.problem or "the program changes it"
    off = {match[1].upper() == "L" for match in CONFIGURATION_OFF.finditer(text)}
    for pose in program.cartesian:
        if any(use.straight in off for use in pose.uses):
            pose.problem = pose.problem or "its configuration is not kept (ConfJ, ConfL \\Off)"


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
        program.leave(match.start(), f"{match[1]} {match[2].split(',')[0].strip()[:40]}: no target of this file")
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
    mark=Mark("  ! {said}", re.compile(r"\s*ENDMODULE\b", re.I)),
)
