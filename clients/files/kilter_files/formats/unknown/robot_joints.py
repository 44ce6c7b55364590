"""Which columns of an unknown table are the joints of a known robot, and which axes beside the arm nobody has placed."""

from __future__ import annotations

import re
from collections.abc import Sequence

from kilter_files.formats.unknown.guess import COMMANDED, OTHER, Columns, Entry, joint_unit, length_unit
from kilter_files.formats.unknown.names import name_as_words
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
