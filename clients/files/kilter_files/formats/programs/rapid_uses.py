"""RAPID: where a module uses a target otherwise than as the goal of a move, so that nothing is corrected in part unseen.

RAPID's robtargets: their numbers and confdata, and the tools and work objects of the moves to them.
"""

from __future__ import annotations

import itertools
import math
import re
from bisect import bisect_right
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import lru_cache

from kilter_files.formats.programs.found import NUMBER, Program, Stated, line_number
from kilter_files.formats.programs.krl_lines import Keyed
from kilter_files.formats.programs.notations import NOT_UNIT, RAPID, Frame
from kilter_files.formats.programs.one_target import PoseTarget
from kilter_files.formats.programs.poses.postures import ConfData, frame_on_track

TYPES = r"(?:robtarget|jointtarget|tooldata|wobjdata)"
DECLARES = Keyed("robtarget jointtarget tooldata wobjdata", rf"\b{TYPES}\s+(\w+)(?:\s*+\{{[\w,*\s]*\}})?\s*+(:=)?")
ASSIGNS = re.compile(r"(?<![\\.\w])(\w+)\s*+(?:\.[\w.]+|\{[^}\n]{0,40}\}[\w.]*)?\s*+:=")
PART_GIVEN = re.compile(
    r"(?<![\\.\w])(\w+)\s*+(?:\{[^}\n]{0,40}\}\s*+)?\.\s*+[A-Za-z_][\w.]{0,80}(?:\{[^}\n]{0,40}\})?(?=\s*+[,;\\])"
)
READS = re.compile(
    r"WHILE|FOR|TEST|CASE|RETURN|(?:Set|TP|UI|EGM|Write|Wait|Pulse|Err|Pack|Move|Arc|Trigg|Search)\w*", re.I
)  # such leave what they are given as it is; a short IF may hold any instruction
WORD = re.compile(r"(?<![\\.\w])([A-Za-z]\w*)(?!\w|\s*+\.\s*+\w)")
OPENS = re.compile(r";|\b(?:THEN|ELSE|DO)\b", re.I)
FIRST = re.compile(r"[A-Za-z]\w*")
ROUTINE = Keyed("proc func", r"\b(?:PROC|FUNC\s+\w+)\s+(\w+)\s*+\(([^()]{0,2000}+)\)")
CONSTANT = Keyed("const", r"\bCONST\s+\w+\s+(\w+)")
BRACKETS = re.compile(r"[()\[\]{},;]")
FUNCTION = re.compile(r"(?<![\\.\w])([A-Za-z]\w*)\s*+\(")
ARGUMENT = re.compile(r"\s*+([A-Za-z]\w*)\s*+(?:\{[^}\n]{0,40}\}\s*+)?(?:\.\s*+\w+\s*+)*")
FUNCTION_READS = re.compile(
    r"Offs|RelTool|C(?:alc)?(?:RobT|JointT|Pos|Tool|WObj)|Distance|Def\w+|Pose\w+|Orient\w+|EulerZYX|MirPos|ORobT"
    r"|A?(?:Sin|Cos|Tan2?)|Abs\w*|Sqrt|Round|Trunc|Max|Min|ValToStr|NumToStr|Dim|DotProd|VectMagn|Present|Is\w+"
    r"|IF|ELSEIF|WHILE|AND|OR|XOR|NOT|DIV|MOD|TEST|CASE|RETURN|TO|FROM|STEP",
    re.I,
)  # functions that only reckon, and words before a bracket
GIVES_BACK = re.compile(r"\b(?:INOUT|VAR|PERS)\b", re.I)
MOVES_SHORT = re.compile(r"(?<=[\s)])(?:Move|Arc|Trigg|Search)\w*(?=[\s\\])", re.I)
LOOKED_BACK = 4000


@dataclass(frozen=True)
class Use:
    """A use of a target: its place, and the instruction to which it is handed, empty where that only reads it."""

    at: int
    name: str
    handed_to: str


def elements(name: str, size: str | None, count: int) -> list[str]:
    """Return the names of the elements of an array as it is written, by row, or its own where it is none."""
    if not size and count == 1:
        return [name]
    said = re.findall(r"\w+", size or "")
    lengths = [int(length) for length in said] if all(length.isdigit() for length in said) else []
    if math.prod(lengths) != count or not lengths:  # a constant of the program says how many
        lengths = [count]
    indices = itertools.product(*(range(1, length + 1) for length in lengths))
    return [f"{name}{{{','.join(map(str, index))}}}" for index in indices]


@lru_cache(maxsize=2)
def variable_changes(text: str) -> list[re.Match[str]]:
    """Return what changes a variable, its name as group 1: assignments, and instructions that are given a part of it.

    Declarations and named arguments are not among them, nor variables that are neither targets nor frames nor parameters.
    """
    own = [*DECLARES.finditer(text)]
    declared = {match.start(1) for match in own}
    names = {match[1].lower() for match in own}
    names |= {one.lower() for match in ROUTINE.finditer(text) for one in re.findall(r"\w+", match[2])}
    by_value = _by_value(text)
    found = [match for match in ASSIGNS.finditer(text) if match[1].lower() in names and match.start(1) not in declared]
    given = (match for match in PART_GIVEN.finditer(text) if match[1].lower() in names)
    found += (match for match in given if _gives_back(text, match.start(), by_value))
    return [*found, *(match for match in _given_to_functions(text, by_value) if match[1].lower() in names)]


def _given_to_functions(text: str, by_value: Collection[str]) -> Iterator[re.Match[str]]:
    """Yield what a function is given that may change it, as ``StrToVal(part, p10.trans.x)`` does; constants are kept."""
    constant = {match[1].lower() for match in CONSTANT.finditer(text)}
    found = [(call[1], call.end()) for call in FUNCTION.finditer(text)]
    kept = {name for name in {name for name, _ in found} if FUNCTION_READS.fullmatch(name) or name.lower() in by_value}
    calls = {at: None for name, at in found if name not in kept}
    end = 0
    for call in calls:
        if call < end:
            continue
        begun: list[int | None] = [
            call
        ]  # where the present argument of each open bracket begins; None: of no such call
        for mark in BRACKETS.finditer(text, call):
            sign, end = mark[0], mark.end()
            if sign in "([{":
                begun.append(end if end in calls else None)
                continue
            given = None if begun[-1] is None or sign == ";" else ARGUMENT.fullmatch(text, begun[-1], mark.start())
            if given is not None and given[1].lower() not in constant:
                yield given
            if sign == "," and begun[-1] is not None:
                begun[-1] = end
            elif sign == ";":
                break
            elif sign != ",":
                begun.pop()
                if not begun:
                    break


def _gives_back(text: str, at: int, by_value: Collection[str]) -> bool:
    """Say whether an instruction may change the part of a variable that it is given, as ``Add p10.trans.z, 5`` does."""
    before = text[_statement_start(text, at) : at]
    if ":=" in before.rpartition(",")[2] or before.count("(") != before.count(")") or is_assigned(text, at):
        return False
    by = _instruction(before, by_value)
    second = by.lower() == "add" and "," in before  # what is added
    return bool(by) and not second and READS.fullmatch(by) is None


@lru_cache(maxsize=2)
def _by_value(text: str) -> frozenset[str]:
    """The routines of the file, in small letters, that change nothing which they are given."""
    return frozenset(match[1].lower() for match in ROUTINE.finditer(text) if GIVES_BACK.search(match[2]) is None)


def declared_again(text: str, names: Collection[str]) -> Iterator[re.Match[str]]:
    """Yield what declares one of these names (small letters) once more: in another routine, or as a parameter."""
    seen: set[str] = set()
    for match in DECLARES.finditer(text):
        name = match[1].lower()
        if name in names and (name in seen or match[2] is None):
            yield match
        seen |= {name}


def is_assigned(text: str, at: int) -> bool:
    """Say whether a place is inside an assignment: moves to what it sets are named where they are."""
    begins, ends = _assignments(text)
    last = bisect_right(ends, at) - 1
    return last >= 0 and begins[last] >= _statement_start(text, at)


def other_uses(text: str, names: Collection[str], understood: Collection[int]) -> Iterator[Use]:
    """Yield each use of a target by a statement that is not understood.

    ``names`` are in small letters; ``understood`` are places at which a move is known to go to the target. Assignments and
    components are left out: what is made of them is named where a move goes to it.
    """
    declared = {match.start(1) for match in DECLARES.finditer(text)}
    by_value = _by_value(text)
    for match in _words_like(names).finditer(text) if names else ():
        at = match.start()
        if match[1].lower() in names and at not in understood and at not in declared:
            if ASSIGNS.match(text, at) or is_assigned(text, at):
                continue
            before = text[_statement_start(text, at) : at]
            bare = before[-1:] in ", \t\r\n" and before.count("(") == before.count(")")
            yield Use(at, match[1], _instruction(before, by_value) if bare else "")


def _words_like(names: Collection[str]) -> re.Pattern[str]:
    """``WORD``, of words that begin as one of some names does, which are in small letters."""
    begin = "".join(sorted({name[0] for name in names if name[0].isascii() and name[0].isalpha()}))
    return re.compile(WORD.pattern.replace("A-Za-z]", f"{begin}{begin.upper()}]", 1) if begin else r"(?!)")


def _statement_start(text: str, at: int) -> int:
    """Where the statement of a place begins, with the words that open a block in front of it."""
    starts = _starts(text)
    return max(at - LOOKED_BACK, starts[bisect_right(starts, at) - 1])


@lru_cache(maxsize=2)
def _starts(text: str) -> list[int]:
    """Where statements begin, in order."""
    return [0, *(match.end() for match in OPENS.finditer(text))]


@lru_cache(maxsize=2)
def _assignments(text: str) -> tuple[list[int], list[int]]:
    """Where assignments begin, and where their signs end, in order."""
    found = [match.span() for match in ASSIGNS.finditer(text)]
    return [begin for begin, _ in found], [end for _, end in found]


def _instruction(before: str, by_value: Collection[str]) -> str:
    """The instruction that may give a target back changed; empty where it is a routine that takes it by value."""
    lines = [line for line in before.splitlines() if FIRST.search(line)]
    found = FIRST.search(lines[-1]) if lines else None
    if found is not None and found[0].upper() == "IF":  # a short one has its instruction behind the condition
        found = MOVES_SHORT.search(lines[-1]) or found
    return "" if found is None or found[0].lower() in by_value else found[0]


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
