"""Joint targets at their places in the text of a program, new numbers at these places, and the moves to them.

CSV: the columns q1_deg, q2_deg, ... (or _rad) of a table with commas; every other cell stays.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import islice
from pathlib import Path

from kilter_files.formats.programs.one_target import JointTarget, PoseTarget, Span, replace_spans
from kilter_files.ground.errors import fault

# every repeat is bounded: a damaged file must not make the search slow
NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
SAME_DEG = 5e-10  # a joint that moves less keeps its characters
MOST_LINES = 400_000  # more than programs have
DATA = "no move of the program goes to these joints, and it uses them otherwise"
EXTERNAL_AXES = "external axes are left out: what they move belongs to the base or the tool"


@dataclass(frozen=True)
class Track:
    """Which way a rail carries the arm's root, in the root's own frame, mm for each unit of the program."""

    along: tuple[float, float, float]


@dataclass(frozen=True)
class Stated:
    """Frames that no program holds, as somebody stated them: numbers by the name or number that the program uses.

    ``tracks`` are external axes, by name in small letters, that carry the arm.
    """

    bases: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    tools: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    tracks: Mapping[str, Track] = field(default_factory=dict)


@dataclass
class Program:
    """The text of a program, its joint targets, and the lines of targets that are left as they are.

    ``cartesian`` are targets given as poses, ``visits`` those of both kinds in the order in which the program moves to them.
    ``moves_to_poses`` are lines that stay as they are where the pose does, or one of those of which they compute which.
    ``moves`` are the targets in the order in which the program moves to them, None where that is to a target which the
    text does not hold; ``poses`` are targets without joints, by name and line. ``unknown`` are moves that make the list of
    joints incomplete: line, what is wrong, and the remedy; ``list_warnings`` are of that list
    alone. ``beside`` is a second file, which declares targets of this one.
    """

    path: Path
    text: str
    dialect: str
    least_decimals: int = 6
    targets: list[JointTarget] = field(default_factory=list)
    left: list[tuple[int, str]] = field(default_factory=list)
    moves: list[JointTarget | None] = field(default_factory=list)
    poses: list[tuple[str, int]] = field(default_factory=list)
    unknown: list[tuple[int, str, str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    list_warnings: list[str] = field(default_factory=list)
    beside: Program | None = None
    stated: Stated = field(default_factory=Stated)
    cartesian: list[PoseTarget] = field(default_factory=list)
    visits: list[JointTarget | PoseTarget] = field(default_factory=list)
    moves_to_poses: list[tuple[int, str, Sequence[PoseTarget]]] = field(default_factory=list)

    def add(
        self, name: str, numbers: Sequence[tuple[str, Span]], radians: Sequence[bool] = (), line: int | None = None
    ) -> JointTarget:
        """Take a target by its numbers and their places."""
        turns = tuple(radians) or (False,) * len(numbers)
        texts, spans = zip(*numbers, strict=True)
        values = tuple(map(float, texts))
        degrees = tuple(map(math.degrees, values)) if all(turns) else values
        if any(turns) and not all(turns):
            degrees = tuple(math.degrees(value) if turn else value for value, turn in zip(values, turns, strict=True))
        place = line_number(self.text, spans[0][0]) if line is None else line
        self.targets.append(JointTarget(name, place, degrees, spans, turns))
        return self.targets[-1]

    def warn(self, what: str) -> None:
        """Say of the whole program what is to be known, once."""
        self.warnings += [] if what in self.warnings else [what]

    def leave(self, at: int, what: str) -> None:
        """Name a target that stays as it is."""
        self.left.append((line_number(self.text, at), what))

    def leave_pose(self, at: int, name: str, what: str) -> None:
        """Name a target that is a pose."""
        self.poses.append((name, line_number(self.text, at)))
        self.leave(at, what)

    def add_pose(self, pose: PoseTarget, *, counted: bool = True) -> PoseTarget:
        """Take a target that is a pose; a list of joints is whole without one that is not ``counted``."""
        self.cartesian.append(pose)
        self.poses += [(pose.name, pose.line)] if counted else []
        return pose

    def leave_targets(self, reasons: Mapping[JointTarget, str]) -> None:
        """Name the joint targets that stay as they are, each with its reason."""
        self.left += [(one.line, f"{one.name}: {reasons[one]}") for one in self.targets if one in reasons]
        self.targets = [one for one in self.targets if one not in reasons]

    def leave_poses(self, reasons: Mapping[PoseTarget, str]) -> None:
        """Name the poses that stay as they are, each with its reason, and the moves to them."""
        if not reasons:
            return
        own = set(self.cartesian)
        self.left += [(one.line, f"{one.name}, a pose: {why}") for one, why in reasons.items() if one in own]
        lines: dict[int, list[int]] = {}
        for line, what, goals in self.moves_to_poses:
            if id(goals) not in lines:  # moves share the list of an array
                lines[id(goals)] = [one.line if one in own else 0 for one in goals if one in reasons]
            if any(line != at for at in lines[id(goals)]):
                self.left.append((line, f"{what}: a pose that is left"))
        self.left = sorted(set(self.left))

    def moves_found(self, found: Iterator[re.Match[str]]) -> list[re.Match[str]]:
        """Return the moves of the text.

        Raises:
            FileError: there are more than a program may have lines.

        """
        moves = [*islice(found, MOST_LINES + 1)]
        if len(moves) > MOST_LINES:
            raise self.refuse(moves[-1].start(), f"is move {len(moves)}", "Part the program into several.")
        return moves

    def refuse(self, at: int, what: str, remedy: str) -> Exception:
        """Build the error of a place."""
        return fault(self.path, what, remedy, line=line_number(self.text, at))

    def rewritten(self, joints_deg: Sequence[Sequence[float]], others: Mapping[Span, str] | None = None) -> str:
        """Return the text with these joints (n rows, deg) in place of the targets' own, and with others; all else stays."""
        new = {
            span: _number(self.text[slice(*span)], value, turn, self.least_decimals)
            for target, row in zip(self.targets, joints_deg, strict=True)
            for span, old, value, turn in zip(target.spans, target.joints_deg, row, target.radians, strict=True)
            if abs(value - old) > SAME_DEG
        }
        return replace_spans(self.text, new | dict(others or {}))


@dataclass(frozen=True)
class Mark:
    """How a program says that it is corrected: a comment with ``{said}`` in it, and the line that it stands before.

    ``most`` are the characters of a version's id that the comment has room for.
    """

    form: str
    before: re.Pattern[str]
    most: int = 64


@dataclass(frozen=True)
class Dialect:
    """A language of robots: the endings of its files, what shows it in a text, and what finds the targets of a program.

    ``remedy`` is how joints of poses become known. ``closed`` are patterns of a first and a last line, and what the last one
    is called: a program with the one and without the other is cut. Only a ``complete`` list of joints is taken, without
    poses; targets of an ``ordered`` dialect stand where the program moves to them. A ``pair`` has two files of one name: the
    ending of the one that moves, and of the one that declares its targets. A table has no ``mark`` in a comment.
    """

    name: str
    endings: tuple[str, ...]
    sign: re.Pattern[str] | None
    find: Callable[[Program], None]
    remedy: str = ""
    closed: tuple[str, str, str] | None = None
    complete: bool = False
    ordered: bool = False
    pair: tuple[str, str] | None = None
    mark: Mark | None = None

    def refuse_cut(self, program: Program) -> None:
        """Refuse a program that ends in the middle.

        Raises:
            FileError: its last line is missing.

        """
        if self.closed is None:
            return
        first, last, called = self.closed
        flags = re.I | re.M
        if re.search(first, program.text, flags) and not re.search(last, program.text, flags):
            raise program.refuse(len(program.text), f"ends without {called}", "Copy or export it again.")


def sign(pattern: str) -> re.Pattern[str]:
    """Return a pattern that shows a dialect."""
    return re.compile(pattern, re.M | re.I)


def _number(old: str, value_deg: float, radians: bool, least: int) -> str:
    return written(old, math.radians(value_deg) if radians else value_deg, least + 2 * radians)


def written(old: str, value: float, least: int) -> str:
    """Write a number in place of another: with as many decimals, and at least these."""
    mantissa, _, exponent = old.lower().partition("e")
    decimals = min(max(len(mantissa.partition(".")[2]) - int(exponent or 0), least), 15)
    return f"{value:{'+' if old[0] == '+' else ''}.{decimals}f}"


@lru_cache(maxsize=4)
def blank_strings_and_comments(text: str, comment: str) -> str:
    """Blank strings and comments: places stay."""
    parts = re.split(rf'("[^"\n]*"|{comment}[^\r\n]*)', text)
    parts[1::2] = [" " * len(said) for said in parts[1::2]]
    return "".join(parts)


def split_lines(text: str) -> list[str]:
    """Return the lines of a text with their ends; unlike ``splitlines`` it takes no letter of Latin-1 for an end."""
    return re.findall(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+", text)


def line_number(text: str, at: int) -> int:
    """Return the line of a place in a text."""
    return bisect_left(_line_ends(text), at) + 1


@lru_cache(maxsize=4)
def _line_ends(text: str) -> list[int]:
    return [match.start() for match in re.finditer("\n", text)]


CELL = re.compile(
    r'[ \t]*+"(?:[^"]|"")*+"[^,\r\n]*+(?:,|$|(?=[\r\n]))|[^,\r\n]*+(?:,|$|(?=[\r\n]))'
)  # a quoted one has commas
SHOWN = 8
BOM = "\xef\xbb\xbf"  # of UTF-8, as it is read byte for byte
JOINT = re.compile(r"q(\d+)_(deg|rad)")
# poses, other joints and their rates: an arm that moves by them is not corrected
BESIDE = re.compile(
    r"(?:\w{1,40}_)?(?:[xyz]_m?m|(?:r[xyz]|[abcwpr]|roll|pitch|yaw)_(?:deg|rad)|q[wxyz]|d{0,2}(?:q|j|e|axis|joint)d{0,2}_?\d{1,2}_\w{1,20})",
    re.I,
)


def find(program: Program) -> None:
    """Find the joints of every row.

    Raises:
        FileError: columns of joints are missing or in two units, or a cell is not a number.

    """
    lines = split_lines(program.text)
    names = [cell[0].strip(' \t,"') for cell in CELL.finditer(lines[0].removeprefix(BOM))]
    twice = next((name for k, name in enumerate(names) if JOINT.fullmatch(name) and name in names[:k]), None)
    if twice is not None:
        raise program.refuse(0, f"has the column {twice} twice", "Leave the one that is meant.")
    joints = {int(match[1]): (k, match[2]) for k, name in enumerate(names) if (match := JOINT.fullmatch(name))}
    if not joints and lines[0].count(";") > lines[0].count(","):
        raise program.refuse(0, "parts its columns with semicolons", "Write it with commas, and points in numbers.")
    if sorted(joints) != [*range(1, len(joints) + 1)] or len({unit for _, unit in joints.values()}) != 1:
        raise program.refuse(0, "lacks joints, or has them in two units", "Name its columns q1_deg, q2_deg, ...")
    beside = [name for name in names if BESIDE.fullmatch(name) and not JOINT.fullmatch(name)]
    if beside:
        named = ", ".join(beside[:SHOWN]) + (f" and {len(beside) - SHOWN} more" if len(beside) > SHOWN else "")
        program.leave(0, f"{named}: poses or joints in other columns than q1, q2, ...")
    at = len(lines[0])
    for number, line in enumerate(lines[1:], 1):
        if line.strip():
            cells = [*CELL.finditer(line)]
            spans = [(joints[k][0], f"q{k}") for k in sorted(joints)]
            found = []
            for column, name in spans:
                bare = re.search(NUMBER, cells[column][0]) if column < len(cells) else None
                if bare is None or bare[0] != cells[column][0].strip(" \t,"):
                    raise program.refuse(at, f"{name} is empty or not a number", "Correct the row.")
                start = at + cells[column].start() + bare.start()
                found.append((bare[0], (start, start + len(bare[0]))))
            program.add(f"row {number}", found, [joints[1][1] == "rad"] * len(found))
        at += len(line)


DIALECT = Dialect("CSV", (".csv",), None, find)
