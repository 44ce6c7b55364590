"""RAPID's robtargets: their numbers and confdata, and the tools and work objects of the moves to them."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator

from kilter_files.formats.programs.found import NUMBER, Program, Stated, line_number
from kilter_files.formats.programs.keyed import Keyed
from kilter_files.formats.programs.notations import NOT_UNIT, RAPID, Frame
from kilter_files.formats.programs.one_target import PoseTarget
from kilter_files.formats.programs.poses.postures import ConfData
from kilter_files.formats.programs.poses.track import frame_on_track
from kilter_files.formats.programs.rapid_uses import ROUTINE, declared_again, other_uses, variable_changes

NULL = Frame(RAPID, (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
UNUSED_AXIS = 8e9
AXES = ("eax_a", "eax_b", "eax_c", "eax_d", "eax_e", "eax_f")
MOVES = re.compile(
    r"Move|Arc|Trigg|Search|Paint|Disp|Spot|Cap|Contact|FCPress|EGM|GripLoad|SetSysData", re.I
)  # beginnings of instructions that move with a tool


def _list(count: int) -> str:
    return r"\[\s*+" + r"\s*+,\s*+".join([f"({NUMBER})"] * count) + r"\s*+\]"


POSE = rf"{_list(3)}\s*+,\s*+{_list(4)}"
TARGET = re.compile(rf"\[\s*+{POSE}\s*+,\s*+{_list(4)}\s*+,\s*+{_list(6)}\s*+\]")
DECLARED = Keyed("robtarget", r"\brobtarget\s+(\w+)\s*+(\{[\w,\s]*\})?\s*+:=([^;]{0,200000})")
TOOL = Keyed("tooldata", rf"\btooldata\s+(\w+)\s*+:=\s*+\[\s*+(TRUE|FALSE)\s*+,\s*+\[\s*+{POSE}\s*+\]")
OBJECT = Keyed(
    "wobjdata",
    rf"\bwobjdata\s+(\w+)\s*+:=\s*+\[\s*+(TRUE|FALSE)\s*+,\s*+(TRUE|FALSE)\s*+,[^,\[\]]{{0,80}},\s*+\[\s*+{POSE}\s*+\]\s*+,\s*+\[\s*+{POSE}\s*+\]",
)
DISPLACED = Keyed("pdispon pdispset eoffson eoffsset", r"\b(?:PDispOn|PDispSet|EOffsOn|EOffsSet)\b")
AXIS_LOCKED = Keyed("singarea", r"\bSingArea\s*+\\\s*+LockAxis4\b")


def parse_pose_target(program: Program, name: str, match: re.Match[str]) -> PoseTarget:
    """Read a robtarget as ``TARGET`` finds it; what it lacks is its problem."""
    values = [*map(float, match.groups())]
    problem = ""
    if abs(sum(part * part for part in values[3:7]) - 1.0) > NOT_UNIT:
        problem = "its orientation is not a unit quaternion"
    quadrants = [int(value) for value in values[7:11] if value == int(value)]
    if len(quadrants) < 4 or not 0 <= quadrants[3] <= 7:
        problem = problem or "its confdata is not understood"
    axes = {name: value for name, value in zip(AXES, values[11:], strict=True) if abs(value) < UNUSED_AXIS}
    root, why = frame_on_track(program.stated, RAPID, axes)
    problem = problem or why
    spans = match.regs
    pose = PoseTarget(
        name, line_number(program.text, spans[0][0]), RAPID, tuple(values[:7]), spans[1:8], problem=problem
    )
    pose.whole, pose.root = spans[0], root
    if len(quadrants) == 4:
        one, four, six, branch = quadrants
        pose.configuration = ConfData((one, four, six), branch, spans[8:11])  # type: ignore[arg-type]
    return pose


class RapidFrames:
    """Tools and work objects by name, or why they are not known."""

    def __init__(self, text: str, stated: Stated) -> None:
        """Read those that a program declares; ``text`` has its comments blanked."""
        self._stated = stated
        set_anew = {match[1].lower() for match in variable_changes(text)}
        self._tools: dict[str, Frame | str] = {}
        for match in TOOL.finditer(text):
            held = match[2].upper() == "TRUE"
            self._tools[match[1].lower()] = _frame(match, 3) if held else f"tool {match[1]} stands still"
        self._objects: dict[str, tuple[Frame, ...] | str] = {}
        for match in OBJECT.finditer(text):
            fixed = match[2].upper() == "FALSE" and match[3].upper() == "TRUE"
            frames = (_frame(match, 4), _frame(match, 11))
            self._objects[match[1].lower()] = frames if fixed else f"work object {match[1]} moves"
        for name in set_anew & self._tools.keys():
            self._tools[name] = f"the program changes tool {name}"
        for name in set_anew & self._objects.keys():
            self._objects[name] = f"the program changes work object {name}"
        for name, by in _frames_passed_to_calls(text, self._tools.keys() | self._objects.keys(), set_anew):
            self._tools |= {name: f"{by} may change tool {name}"} if name in self._tools else {}
            self._objects |= {name: f"{by} may change work object {name}"} if name in self._objects else {}
        for match in declared_again(text, self._tools.keys() | self._objects.keys()):
            name, why = match[1].lower(), f"{match[1]} is declared several times"
            self._tools |= {name: why} if name in self._tools else {}
            self._objects |= {name: why} if name in self._objects else {}

    def tool(self, name: str) -> Frame | str:
        """Return a tool."""
        found = self._tools.get(name.lower())
        stated = self._stated.tools.get(name)
        if not isinstance(found, Frame) and stated is not None:
            return Frame(RAPID, stated)
        if found is None and name.lower() == "tool0":
            return NULL
        return found or f"tool {name} is not in this program: state it, --tool {name}=x,y,z,q1,q2,q3,q4"

    def base(self, name: str) -> tuple[Frame, ...] | str:
        """Return a work object: its user frame and, in it, its object frame."""
        found = self._objects.get(name.lower())
        stated = self._stated.bases.get(name)
        if not isinstance(found, tuple) and stated is not None:
            return (Frame(RAPID, stated),)
        if found is None and name.lower() == "wobj0":
            return (NULL,)
        return found or f"work object {name} is not in this program: state it, --base {name}=x,y,z,q1,q2,q3,q4"


def _frames_passed_to_calls(text: str, names: Collection[str], changed_names: set[str]) -> Iterator[tuple[str, str]]:
    """Yield each tool or work object that something is given which may change it: no move, and no routine that does not."""
    keep = {
        match[1].lower()
        for match in ROUTINE.finditer(text)
        if not changed_names & {name.lower() for name in re.findall(r"(\w+)\s*+(?:,|$)", match[2])}
    }
    for use in other_uses(text, names, ()):
        by = use.handed_to
        if by and by.lower() not in keep and not MOVES.match(by):
            yield use.name.lower(), by


def _frame(match: re.Match[str], first: int) -> Frame:
    return Frame(RAPID, tuple(float(match[k]) for k in range(first, first + 7)))
