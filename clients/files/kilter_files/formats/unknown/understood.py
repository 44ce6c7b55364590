"""What names and ranges tell of an unknown table: joints, position, orientation, time and conditions.

How an unknown table is read: its columns with ranges, what a draft takes them for, and how to send it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from shlex import quote

from kilter_files.formats.reader import Document, Head
from kilter_files.formats.unknown.guess import (
    COMMANDED,
    OTHER,
    Columns,
    Entry,
    find_entry_by_words,
    joint_unit,
    joints,
    length_unit,
    name_as_words,
    points,
    position_entries,
    time,
    triples,
)
from kilter_files.formats.unknown.table_shape import TableShape, detect_table_shape
from kilter_files.formats.unknown.turns import Turned, find_orientation
from kilter_files.ground.cell_numbers import parse_number
from kilter_files.ground.errors import FileError
from kilter_files.ground.units import SIZES, UNKNOWN

EXTERNAL = re.compile(
    r"\b(?:e ?[1-6]|eax(?: [a-f])?|ext(?:ernal)?(?: ?(?:ax\w*|joint))? ?\d?|rail|track|gantry|positioner)\b"
)
AXIS_NUMBER = re.compile(r"(?<=[a-z])(?=\d)")


def robot_joints(columns: Columns, robot: Sequence[str], found: Sequence[Entry]) -> list[Entry]:
    """Return the lines of the joints of a robot, by their names or else by their kinds; ``:m`` ends the prismatic ones.

    ``found`` are the lines that names and ranges tell without it. They stay where they are as many as the robot has.
    """
    names = _columns_by_name(columns, robot)
    if not names:
        used = [name for entry in found for name in entry.used]
        if len(used) == len(robot):
            return list(found)
        names = _columns_by_kind(robot, used, external_axes(columns, used))
    if not names:
        told = f"the robot has {len(robot)} joints ({', '.join(robot)}): write one line for each"
        return [Entry("q*", UNKNOWN, UNKNOWN, told)]
    turning = [name for name, joint in zip(names, robot, strict=True) if not joint.endswith(":m")]
    out = []
    for number, (name, joint) in enumerate(zip(names, robot, strict=True), 1):
        slides = joint.endswith(":m")
        unit, remark = length_unit(columns, [name]) if slides else joint_unit(columns, name, turning)
        out.append(Entry(f"q{number}_{'mm' if slides else 'deg'}", name, unit, remark, (name,)))
    return out


def external_axes(columns: Columns, taken: Sequence[str]) -> list[str]:
    """Return columns of numbers, none of them taken, that are named as an axis beside the arm: a rail, a positioner."""
    free = [name for name in columns.names if name not in taken and columns.numbers(name)]
    return [n for n in free if EXTERNAL.search(name_as_words(n)) and not OTHER.search(name_as_words(n))]


def unplaced_axes(columns: Columns, found: Sequence[Entry]) -> Entry | None:
    """Return the line that asks for the place of axes beside the arm, None where there are none."""
    named = external_axes(columns, [name for entry in found for name in entry.used])
    beside = [name for name in named if len(set(columns.numbers(name) or ())) > 1]  # a KUKA log has E1 to E6 at rest
    if not found or not beside or any(entry.open for entry in found):
        return None
    told = (
        f"{', '.join(beside)} may be joints of the robot too, first or last: draft with --robot ROBOT, or write one line for "
        f"each joint; the others are {', '.join(name for entry in found for name in entry.used)}"
    )
    return Entry("q*", UNKNOWN, UNKNOWN, told, tuple(name for entry in found for name in entry.used))


def _columns_by_kind(robot: Sequence[str], turning: Sequence[str], beside: Sequence[str]) -> list[str]:
    """Return the columns in the robot's order where its only prismatic joints are the axes beside the arm."""
    slides = [joint.endswith(":m") for joint in robot]
    if not beside or slides.count(True) != len(beside) or slides.count(False) != len(turning):
        return []
    lengths, angles = iter(beside), iter(turning)
    return [next(lengths if slide else angles) for slide in slides]


def _columns_by_name(columns: Columns, robot: Sequence[str]) -> list[str]:
    """Return the column of each joint: that which says its name with the fewest further words, none where two do."""
    out: list[str] = []
    for joint in robot:
        said = _words(joint.removesuffix(":m"))
        ranked = sorted(
            (rest, name)
            for name in columns.names
            if columns.numbers(name) and (rest := _further_words(_words(name), said)) is not None
        )
        if not ranked or (len(ranked) > 1 and ranked[0][0] == ranked[1][0]):
            return []
        out.append(ranked[0][1])
    return out if len(set(out)) == len(robot) else []


def _words(name: str) -> str:
    return " ".join(AXIS_NUMBER.sub(" ", name_as_words(re.sub(r"\s*[\[(].*$", "", name))).split())


def _further_words(said: str, joint: str) -> tuple[bool, int] | None:
    """Return whether a name is of a command, and how many words beside the joint's; None where it is of something else."""
    if not re.search(rf"\b{re.escape(joint)}\b", said):
        return None
    rest = re.sub(rf"\b{re.escape(joint)}\b", " ", said, count=1)
    units = {unit.lower() for sizes in (SIZES["angle"], SIZES["length"]) for unit in sizes}
    words = [word for word in rest.split() if word not in units]
    return None if OTHER.search(rest) else (bool(COMMANDED.search(rest)), len(words))


POSES = "poses?|pose id|punkt|point|messpunkt|label"
LONGEST_NAME = 40


@dataclass(frozen=True)
class Understood:
    """An unknown table: its entries of a map, the orientation, and columns that might be the joints or the position.

    ``axes`` are the entries of the joints, as far as the table has any.
    """

    columns: Columns
    axes: tuple[Entry, ...]
    entries: tuple[Entry, ...]
    turn: Turned | None
    other_joints: tuple[str, ...]
    other_places: tuple[str, ...]
    taken: frozenset[str]

    @property
    def shape(self) -> TableShape:
        """How the table is laid out."""
        return self.columns.shape

    @property
    def unused_columns(self) -> list[str]:
        """Columns that no entry takes."""
        return [name for name in self.columns.names if name not in self.taken]

    @property
    def open(self) -> list[str]:
        """Places that somebody has to fill in."""
        places = [f"columns.{entry.target}" for entry in self.entries if entry.open]
        return places + (["orientation"] if self.turn and self.turn.open else [])

    @property
    def guess_remarks(self) -> list[str]:
        """What was taken by names and ranges, and is to be checked."""
        return [f"{entry.target}: {entry.remark}" for entry in self.entries if entry.remark and not entry.open]


def cached_understanding(head: Head) -> Understood | None:
    """What names and ranges tell of a file, None where it holds no table of numbers; of one head it is found out once."""
    if "table" not in head.found:
        try:
            head.found["table"] = understand(head.path, head.hints.robot)
        except FileError:
            head.found["table"] = None
    found: Understood | None = head.found["table"]
    return found


def understand(path: Path, robot: Sequence[str] = ()) -> Understood:
    """Find out what the columns of a file are; ``robot`` are the joints of the arm, prismatic ones with ``:m`` at the end.

    Raises:
        FileError: no table of numbers is found in it.

    """
    columns = Columns(detect_table_shape(path))
    turn = find_orientation(columns)
    pose = {*turn.names, *turn.place, *turn.rest} if turn else set()
    axes, others = _arm(columns.without_names(list(pose)), robot)
    taken = {name for entry in axes for name in entry.used} | pose
    place, elsewhere = (position_entries(columns, turn.place), []) if turn and turn.place else points(columns, taken)
    entries = [*axes] or [_unknown_joints(columns.without_names(list(pose)))]
    entries += place or [Entry(f"{a}_mm", UNKNOWN, "mm", _unknown_place(columns, taken)) for a in "xyz"]
    taken |= {name for entry in place for name in entry.used}
    for entry in _time_and_condition_entries(columns, taken):
        entries.append(entry)
        taken |= set(entry.used)
    return Understood(columns, tuple(axes), tuple(entries), turn, tuple(others), tuple(elsewhere), frozenset(taken))


def _arm(columns: Columns, robot: Sequence[str]) -> tuple[list[Entry], list[str]]:
    """Lines of the joints, and other columns that might be joints."""
    found, others = joints(columns)
    if robot:
        return robot_joints(columns, robot, found), others
    beside = unplaced_axes(columns, found)
    return (found if beside is None else [beside]), others


def _unknown_joints(columns: Columns) -> Entry:
    numeric = [name for name in columns.names if columns.numbers(name)]
    told = (
        'could not determine which columns are joints, write one line each or from = "A*"; numbers are in '
        f"{joined_names(numeric)}"
    )
    return Entry("q*", UNKNOWN, UNKNOWN, told)


def _unknown_place(columns: Columns, taken: set[str]) -> str:
    """Why no position was found: its columns may hold cells that are not numbers."""
    told, decimal = "could not determine which column this is", columns.shape.layout.decimal
    for triple in triples([name for name in columns.names if name not in taken]):
        for name in triple.names:
            if columns.numbers(name) is None:
                cell = next(cell for cell in columns.texts(name) if cell and parse_number(cell, decimal) is None)
                return f"{told}: {name} holds {cell!r}. Write numbers without separators of thousands"
    return told


def _time_and_condition_entries(columns: Columns, taken: set[str]) -> list[Entry]:
    """Time, temperature, payload and pose numbers."""
    found = [time(columns, taken)]
    for words, make in (
        (r"temp\w*|t", _temperature),
        ("payload|load|last|nutzlast|mass|masse", _payload),
        (POSES, _pose),
    ):
        found.append(find_entry_by_words(columns, taken, words, partial(make, columns)))
    found += [] if found[-1] is not None else [_named_pose(columns, taken)]
    return [entry for entry in found if entry is not None]


def _temperature(columns: Columns, name: str) -> Entry | None:
    unit = columns.unit(name)
    called = bool(re.search(r"\btemp|\b(?:deg ?c|celsius|air|room|amb\w*|luft|raum|umgebung)\b", name_as_words(name)))
    if unit not in ("C", "K") and not (unit is None and called):
        return None
    return Entry("temperature_c", name, unit or "C", "" if unit else "the file states no unit", (name,))


def _payload(columns: Columns, name: str) -> Entry | None:
    unit = columns.unit(name)
    if unit is not None and unit not in SIZES["mass"]:
        return None
    return Entry("payload_kg", name, unit or UNKNOWN, "" if unit else "the file states no unit: kg or g", (name,))


def _named_pose(columns: Columns, taken: set[str]) -> Entry | None:
    """A column that names the pose of each row in words, as ``P1`` and ``P2``."""
    for name in columns.names:
        if name not in taken and columns.numbers(name) is None and re.search(rf"\b(?:{POSES})\b", name_as_words(name)):
            cells = columns.texts(name)
            if all(cells) and len(set(cells)) > 1 and max(map(len, cells)) <= LONGEST_NAME:
                return Entry("pose_id", name, None, "names become numbers", (name,))
    return None


def _pose(columns: Columns, name: str) -> Entry | None:
    whole = all(value.is_integer() for value in columns.numbers(name) or ())
    return Entry("pose_id", name, None, "", (name,)) if whole else None


def joined_names(names: Sequence[str]) -> str:
    """Return the first names in one line."""
    return ", ".join(" ".join(name.split()) for name in names[:20]) + (" ..." if len(names) > 20 else "")


def describe_table(head: Head) -> Document:
    """Describe a table that no reader of a device knows.

    Raises:
        FileError: no table of numbers.

    """
    found = cached_understanding(head) or understand(head.path, head.hints.robot)
    shape, columns = found.shape, found.columns
    out = []
    for name in columns.names:
        values = columns.numbers(name)
        low, high = (min(values), max(values)) if values else (None, None)
        empty = len(shape.source.lines) - len(values) if values is not None and shape.source.lines else None
        out.append({"name": name, "unit": columns.unit(name), "low": low, "high": high, "empty": empty})
    sheet = [] if shape.layout.sheet is None else [f"sheet {shape.layout.sheet!r}"]
    read = [f"check {text}" for text in found.guess_remarks] + [f"not told: {text}" for text in found.open]
    read += [f"not used: {', '.join(found.unused_columns)}"] if found.unused_columns else []
    note = (
        f"comes in with a column map; a first one: kilter measure inspect {quote(str(head.path))} --draft columns.toml"
    )
    return {"kind": "table", "rows": len(shape.source.lines), "columns": out, "notes": [*sheet, *read, note]}
