"""The moves of a RAPID program, one after another: their targets, frames, and the target before each."""

from __future__ import annotations

import re

from kilter_files.formats.programs.found import EXTERNAL_AXES, NUMBER, Program, line_number
from kilter_files.formats.programs.keyed import Keyed
from kilter_files.formats.programs.one_target import JointTarget, PoseTarget, Use
from kilter_files.formats.programs.poses.rapid import TARGET, UNUSED_AXIS, RapidFrames, arguments, parse_pose_target
from kilter_files.formats.programs.poses.rapid_computed import CALL, Computed
from kilter_files.formats.programs.poses.rapid_flow import RapidFlow

SIX = r"\[\s*+" + r"\s*+,\s*+".join([f"({NUMBER})"] * 6) + r"\s*+\]"
PAIR = re.compile(rf"\[\s*+{SIX}\s*+,\s*+{SIX}\s*+\]")
MOVE = Keyed(
    "move arc trigg search",
    r"\b(Move\w{1,20}|Arc[LC]\d?(?:Start|End)?|Trigg[LJC]|Search[LC])(?=[\s\\])\s*+([^;]{0,2000}+)(;|\Z)",
)
TO_POSES = re.compile(r"(?:Move|Trigg|Arc)([JLC])(?:DO|AO|GO|Sync|\d?(?:Start|End))?\d?", re.I)
TO_TOOL = {"M": 2, "T": 3, "A": 4}  # arguments between goals and tool: speed and zone, a trigger, seam and weld
SENSED = re.compile(r"\\\s*+(?:Corr\b|Track\s*+:=)", re.I)
INDEX = r"\{\s*+\d+\s*+(?:,\s*+\d+\s*+){0,2}\}"
WRITTEN = re.compile(rf"\w+(?:\s*+{INDEX})?|\[.*\]", re.S)
ANY_ELEMENT = re.compile(r"(\w+)\s*+\{[^{}]{1,80}\}", re.S)  # the program computes which
WITH = re.compile(r"(\w+)\s*+((?:\\[^\\]{1,80})*)")
WORK_OBJECT = re.compile(r"\\\s*+WObj\b\s*+(?::=\s*+(\w+)\s*+(?=\\|$))?", re.I)
GOAL = re.compile(rf"(\w+)\s*+({INDEX}|\{{[^}}]{{0,80}}\}})?\s*+(?:\\.*)?", re.S)

# by the name of the variable, and there by that of the element, both in small letters
Known = dict[str, dict[str, JointTarget]]
Poses = dict[str, dict[str, PoseTarget]]


class RapidMoves:
    """Takes moves in the order of the text; ``text`` has its comments blanked.

    ``understood`` are places of goals that are known, ``moved`` the joint targets to which a move goes, ``set_anew`` names that
    the program changes, all in small letters.
    """

    def __init__(self, program: Program, text: str, known: Known, poses: Poses, set_anew: set[str]) -> None:
        """Take the targets that the program declares."""
        self._program, self._text, self._known, self._poses, self._set_anew = program, text, known, poses, set_anew
        self._frames = RapidFrames(text, program.stated)
        self._flow = RapidFlow(text)
        self._computed = Computed(program, text, self._declared_target)
        self._last: tuple[int, JointTarget | PoseTarget] | None = None
        self.understood: set[int] = set()
        self.moved: set[str] = set()

    def add_move(self, match: re.Match[str]) -> bool:
        """Take a move, or name its line; whether its targets are known."""
        taken = self._to_poses(match) or self._to_joints(match)
        if not taken:
            self._last = None
        self.understood |= self._computed.named
        return taken

    def _to_poses(self, match: re.Match[str]) -> bool:
        """Take the robtargets of a move as moves to them."""
        way = TO_POSES.fullmatch(match[1])
        said = [(match.start(2) + at, one) for at, one in arguments(match[2]) if not one.startswith("\\")]
        if way is None:
            self._say_unused(match, said, f"{match[1]} does not surely end at it")
            return False
        count = 2 if way[1].upper() == "C" else 1
        with_tool = count + TO_TOOL[match[1][0].upper()]
        goals = [self._goals(match[1], at, one) for at, one in said[:count]]
        if len(said) <= with_tool or not all(goals):
            lacks = "lacks arguments" if len(said) <= with_tool else "goes to a target too that is not known"
            self._say_unused(match, said, f"{match[1]} {lacks}")
            return False
        held = WITH.fullmatch(said[with_tool][1])
        self.understood.update(at for at, _ in said[:count])
        if SENSED.search(match[2]):
            self._program.leave(match.start(), f"{match[1]} {said[0][1][:40]}: a sensor moves it beside its target")
            for goal in (one for several in goals for one in several):
                goal.unused = "the moves to it add what a sensor says (\\Corr, \\Track)"
            self._last = None
            return True
        for several in goals:
            uses = self._uses(match.start(), held, way[1].upper())
            for goal in several:
                goal.uses += uses
                what = f"{match[1]} {said[0][1][:40]}"
                self._program.moves_to_poses.append((line_number(self._text, match.start()), what, goal))
            self._last = (match.start(), several[0]) if len(several) == 1 else None
        return True

    def _uses(self, at: int, held: re.Match[str] | None, way: str) -> list[Use]:
        """A move to a target; one for each way in which the controller may choose the posture there."""
        work = WORK_OBJECT.search(held[2]) if held else None
        unclear = work is not None and not work[1]
        base = "its work object is not understood" if unclear else self._frames.base(work[1] if work else "wobj0")
        tool = self._frames.tool(held[1]) if held else "its tool is not understood"
        joined = self._last is not None and self._flow.has_unbranched_path(self._last[0], at)
        near = self._last[1] if self._last is not None and joined else None
        kind = "J" if way == "J" else "L"
        possible = self._flow.off(kind, at)
        is_off = f"Conf{kind} \\Off {'may be' if len(possible) > 1 else 'is'} in force"
        return [Use(base, tool, near, way != "J", is_off if off else "") for off in possible]

    def _say_unused(self, match: re.Match[str], said: list[tuple[int, str]], why: str) -> None:
        """Note of the targets of a move that is left why it is: nothing else may tell what becomes of them."""
        for _, one in said:
            name = re.match(r"\w+", one)
            for pose in self._poses.get(name[0].lower(), {}).values() if name else ():
                pose.unused = f"{why} (line {line_number(self._text, match.start())})"

    def _goals(self, move: str, at: int, said: str) -> list[PoseTarget]:
        """The target that a move says, all elements of an array of which it computes the index, or none."""
        said = re.sub(r"\\\s*+ID\s*+:=.*", "", said).strip()
        if CALL.fullmatch(said):
            computed = self._computed.add_computed_target(at, said)
            return [] if computed is None else [computed]
        if said[:1] == "[":
            written = TARGET.match(self._text, at)
            return (
                [self._program.add_pose(parse_pose_target(self._program, move, written), counted=False)]
                if written
                else []
            )
        if not WRITTEN.fullmatch(said):
            element = ANY_ELEMENT.fullmatch(said)
            return [*self._poses.get(element[1].lower(), {}).values()] if element is not None else []
        found = self._declared_target(said)
        return [] if found is None else [found]

    def _declared_target(self, said: str) -> PoseTarget | None:
        """The declared robtarget of this name, or element of an array."""
        said = "".join(said.lower().split())
        return self._poses.get(said.partition("{")[0], {}).get(said)

    def _to_joints(self, match: re.Match[str]) -> bool:
        """Take the joints of a move, or name its line."""
        program, joints = self._program, match[1].lower() == "moveabsj"
        at, said = next(((at, one) for at, one in arguments(match[2]) if not one.startswith("\\")), (0, ""))
        at += match.start(2)
        written = PAIR.match(self._text, at) if joints else None
        goal = GOAL.fullmatch(said)
        targets = self._known.get(goal[1].lower(), {}) if joints and goal is not None else {}
        target = None
        if written is not None:
            target = take_joints(program, match[1], written)
        elif goal is not None and targets:
            self.moved.add(goal[1].lower())
            target = targets.get("".join(f"{goal[1]}{goal[2] or ''}".lower().split()))
        else:
            program.leave(match.start(), f"{match[1]} {said[:40]}: no target of this file")
            program.moves += [None] if joints else []
            return False
        program.moves.append(target)
        sure = target is not None and (written is not None or (goal and goal[1].lower()) not in self._set_anew)
        self._last = (match.start(), target) if target is not None and sure else None
        self.understood.add(at)
        return True


def take_joints(program: Program, name: str, pair: re.Match[str]) -> JointTarget:
    """Take six joints and six external axes."""
    if any(abs(value) < UNUSED_AXIS and value != 0 for value in map(float, pair.groups()[6:])):
        program.warn(EXTERNAL_AXES)
    numbers = [(pair[k], pair.span(k)) for k in range(1, 7)]
    return program.add(name, numbers, line=line_number(program.text, pair.start()))
