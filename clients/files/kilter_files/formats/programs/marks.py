"""The mark of a program whose targets are corrected: to correct them once more would move the arm wrongly.

It is a comment on a line of its own before the last line of a program, so that no target changes its line; a table has
a column for it. Whoever teaches targets anew on the controller removes it.

Joint targets of a program as a list of joints, in the order in which the program moves to them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kilter_files.formats.programs.dialects import DIALECTS
from kilter_files.formats.programs.found import CELL, Dialect, Program, split_lines
from kilter_files.formats.programs.one_target import JointTarget
from kilter_files.ground.errors import fault, read_head
from kilter_files.ground.text_layout import detect_encoding

SAID = re.compile(r"^\s{0,9}(?:\d{0,6}\s{0,9}:\s{0,9})?[;!#]\s{0,9}Kilter corrected (\w{1,64})\s{0,9};?\s*+$", re.I)
NUMBERED = re.compile(r"\s{0,9}(\d{1,6})\s{0,9}:")
COLUMN = "kilter_corrected"
REMEDY = "Filter the program as it was taught. If its targets were taught anew since, say --again (again=True)."


def refuse_corrected(programs: Sequence[Program]) -> None:
    """Refuse a program that was corrected already.

    Raises:
        FileError: one of its files has the mark.

    """
    for program in programs:
        lines = split_lines(program.text)
        place = _place_of_column(lines) if DIALECTS[program.dialect].mark is None else None
        for number, line in enumerate(lines, 1):
            said = SAID.search(line)
            version = said and said[1]
            if place is not None and number > 1:
                version = _cell(line, place)[0].strip(' \t,"')
            if version:
                what = f"its targets are corrected already, by version {version}"
                raise fault(program.path, what, REMEDY, line=number)


def is_correction_mark(line: str) -> bool:
    """Say whether a line is the mark of a corrected program."""
    return SAID.search(line) is not None


def add_correction_mark(program: Program, text: str, version: str) -> str:
    """Return the corrected text of a program with the mark of a version, in place of an older one."""
    mark, lines = DIALECTS[program.dialect].mark, split_lines(text)
    if mark is None:
        return "".join(_with_cell(lines, version))
    lines = [line for line in lines if not SAID.search(line)]
    numbers = [int(found[1]) for line in lines if (found := NUMBERED.match(line))]
    number = 1 + max(numbers) if numbers else ""
    said = mark.form.format(said=f"Kilter corrected {version[: mark.most]}", number=number)
    closing = [k for k, line in enumerate(lines) if mark.before.match(line)]
    lines.insert(closing[-1] if closing else 0, said + _line_ending(lines))
    return "".join(lines)


def _line_ending(lines: Sequence[str]) -> str:
    return "\r\n" if lines and lines[0].endswith("\r\n") else "\n"


def _place_of_column(lines: Sequence[str]) -> int | None:
    names = [cell[0].strip(' \t,"') for cell in CELL.finditer(lines[0].rstrip("\r\n"))]
    return names.index(COLUMN) if COLUMN in names else None


def _cell(line: str, place: int) -> tuple[str, int]:
    """A cell with its comma, and where it begins; empty where the row has none."""
    cells = [*CELL.finditer(line.rstrip("\r\n"))]
    return (cells[place][0], cells[place].start()) if place < len(cells) else ("", len(line.rstrip("\r\n")))


def _with_cell(lines: Sequence[str], version: str) -> list[str]:
    """The rows of a table with the version in the column of the mark, the last one where there was none."""
    place, out = _place_of_column(lines), []
    for number, line in enumerate(lines):
        bare = line.rstrip("\r\n")
        if not bare.strip():
            out.append(line)
        elif place is None:
            out.append(f"{bare},{version if number else COLUMN}{line[len(bare) :]}")
        else:
            old, at = _cell(line, place)
            new = f"{version if number else COLUMN}{',' if old.endswith(',') else ''}"
            out.append(line[:at] + new + line[at + len(old) :])
    return out


MOST_BYTES = 16 << 20
LOOKED_AT = 1 << 18
SHOWN = 5
LOOP = re.compile(r"^[ \t]*+(?:FOR|WHILE|GOTO)\b", re.I | re.M)
UNKNOWN_ORDER = "in the order of their declarations: the program's own order cannot be read from it"


@dataclass(frozen=True)
class Targets:
    """Joints in deg (n rows), the name and the line of each, and what was understood."""

    dialect: str
    joints_deg: list[list[float]]
    names: list[str]
    lines: list[int]
    notes: list[str]
    warnings: list[str]


def detect_dialect(path: Path) -> str | None:
    """Return whose program a text is by its content, None when it holds no joint targets."""
    head = read_head(path, LOOKED_AT)
    if b"\0" in head and not head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return None
    text = head.decode(detect_encoding(path, head), "replace")
    return next((name for name, one in DIALECTS.items() if one.sign is not None and one.sign.search(text)), None)


def read_targets(path: Path) -> Targets:
    """Read the joint targets of a program, in the order in which it moves to them, else as they are declared.

    Raises:
        FileError: no targets, one that is damaged, targets of several arms, or poses only.

    """
    name = detect_dialect(path)
    if name is None:
        known = [name for name, dialect in DIALECTS.items() if dialect.sign is not None]
        raise fault(path, "holds no joint targets", f"{', '.join(known)} are understood.")
    content = read_head(path, MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise fault(path, f"is larger than {MOST_BYTES >> 20} MB", "Is it a program?")
    program = Program(path, content.decode(detect_encoding(path, content), "replace").removeprefix("\ufeff"), name)
    DIALECTS[name].find(program)
    _refuse_incomplete(program, DIALECTS[name])
    rows = _in_order(program, DIALECTS[name])
    _refuse_empty(program, rows, DIALECTS[name])
    notes = [f"{name}: {len(rows)} joint targets, in degrees", *program.notes]
    warnings = [*program.warnings, *program.list_warnings]
    if program.poses:
        said = f"{len(program.poses)} targets are left out because they are poses without joints: {_poses(program)}"
        warnings.append(said)
    joints = [list(row.joints_deg) for row in rows]
    return Targets(name, joints, [row.name for row in rows], [row.line for row in rows], notes, warnings)


def _refuse_incomplete(program: Program, dialect: Dialect) -> None:
    if program.unknown:
        line, what, remedy = program.unknown[0]
        raise fault(program.path, what, remedy, line=line)
    if dialect.complete and program.poses:
        several = len(program.poses) > 1
        what = f"are given as poses: {_poses(program)}" if several else f"{program.poses[0][0]} is given as a pose"
        remedy = f"Show {'them' if several else 'it'} as joints on the pendant (REPRE) and export again."
        raise fault(program.path, what, remedy, line=program.poses[0][1])


def _in_order(program: Program, dialect: Dialect) -> list[JointTarget]:
    """The targets as the program moves to them, when that can be known from its text; how is noted."""
    moves = [move for move in program.moves if move is not None]
    if dialect.ordered and moves:
        program.notes.append("in the order in which the program moves to them")
        return moves
    if not moves:
        program.notes.append("in the order in which their declarations are written: the program moves to none of them")
    elif len(moves) < len(program.moves) or LOOP.search(program.text):
        program.warnings.append(UNKNOWN_ORDER)
    else:
        program.notes.append("in the order in which the program moves to them")
        return moves
    return program.targets


def _refuse_empty(program: Program, rows: list[JointTarget], dialect: Dialect) -> None:
    if not rows and program.poses:
        what = f"holds poses and no joints: {_poses(program)}"
        raise fault(program.path, what, f"{dialect.remedy}.", line=program.poses[0][1])
    if not rows:
        raise fault(program.path, f"holds no joint targets of {dialect.name}", "Give joint targets, not poses.")
    odd = next((row for row in rows if len(row.joints_deg) != len(rows[0].joints_deg)), None)
    if odd is not None:
        what = f"{odd.name} has {len(odd.joints_deg)} joints, the first {len(rows[0].joints_deg)}"
        raise fault(program.path, what, "Give the targets of one arm.", line=odd.line)


def _poses(program: Program) -> str:
    """Name the first poses with their lines."""
    more = f" and {len(program.poses) - SHOWN} more" if len(program.poses) > SHOWN else ""
    return ", ".join(f"{name} (line {line})" for name, line in program.poses[:SHOWN]) + more
