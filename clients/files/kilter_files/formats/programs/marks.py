"""The mark of a program whose targets are corrected: to correct them once more would move the arm wrongly.

It is a comment on a line of its own before the last line of a program, so that no target changes its line; a table has
a column for it. Whoever teaches targets anew on the controller removes it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from kilter_files.formats.programs.dialects import DIALECTS
from kilter_files.formats.programs.found import Program, split_lines
from kilter_files.formats.programs.table import CELL
from kilter_files.ground.errors import fault

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
