"""CSV: the columns q1_deg, q2_deg, ... (or _rad) of a table with commas; every other cell stays."""

from __future__ import annotations

import re

from kilter_files.formats.programs.found import NUMBER, Dialect, Program, split_lines

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
