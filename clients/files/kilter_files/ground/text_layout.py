"""How a foreign text file is laid out: encoding, delimiter, decimal sign, header, units row, first line of numbers."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kilter_files.ground.cell_numbers import parse_number
from kilter_files.ground.errors import fault, read_head
from kilter_files.ground.units import SIZES

SAMPLE_BYTES = 1 << 18
SAMPLE_LINES = 400
CELLS_BYTES = 1 << 16
TRIES = ((";", "."), (";", ","), ("\t", "."), ("\t", ","), (",", "."), (" ", "."), (" ", ","))
COMMENTS = ("//", "#", "%", "!")
UNITS = {unit.lower(): unit for sizes in SIZES.values() for unit in sizes} | {
    "°": "deg",
    "degree": "deg",
    "degrees": "deg",
    "grad": "deg",
    "radians": "rad",
    "millimeter": "mm",
    "millimeters": "mm",
    "meter": "m",
    "meters": "m",
    "inches": "inch",
    "in": "inch",
    "sec": "s",
    "seconds": "s",
    "msec": "ms",
    "µm": "um",
    "micron": "um",
    "c": "C",
    "°c": "C",
    "degc": "C",
    "deg c": "C",
    "celsius": "C",
    "k": "K",
    "-": "",
    "": "",
    "1": "",
    "mm/m": "mrad",
}
LONGEST_UNIT = 4  # letters of a unit that nobody knows here: longer words in brackets say something else
IN_NAME = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]\s*$")


@dataclass(frozen=True)
class TextLayout:
    """The layout; lines count from 1, ``names`` are as written without their units, ``units`` in our spelling."""

    encoding: str
    delimiter: str
    decimal: str
    first_line: int
    names: tuple[str, ...]
    units: tuple[str | None, ...]
    above: tuple[tuple[str, ...], ...]
    width: int
    header: bool

    def to_document(self) -> dict[str, Any]:
        """Return what is to be said of the layout."""
        told = zip(self.names, self.units, strict=True)
        return {
            "encoding": self.encoding,
            "delimiter": self.delimiter,
            "decimal": self.decimal,
            "first_row_in_line": self.first_line,
            "header": self.header,
            "columns": [{"name": name, "unit": unit} for name, unit in told],
        }

    def split(self, line: str) -> list[str]:
        """Return the cells of a line."""
        return split_line(line, self.delimiter)


def sniff(path: Path) -> TextLayout:
    """Find out how a text file is laid out.

    Raises:
        FileError: a binary or empty file, or no table of numbers in its beginning.

    """
    head = read_head(path, SAMPLE_BYTES)
    encoding = detect_encoding(path, head)
    lines = head.decode(encoding, errors="ignore").splitlines()[:SAMPLE_LINES]
    if len(head) == SAMPLE_BYTES and len(lines) < SAMPLE_LINES:
        lines = lines[:-1]  # the last may be cut
    best = max(TRIES, key=lambda pair: _score(lines, *pair))
    if _score(lines, *best) <= 0:
        raise fault(path, "no table of numbers was found in its beginning", "Export it as CSV with one row per frame.")
    return _layout(path, lines, encoding, *best)


def lines_in_cells(path: Path) -> bool:
    """Tell whether quoted cells of a text go over several lines."""
    text = read_head(path, CELLS_BYTES).decode("utf-8", "replace")
    reader = csv.reader(text.splitlines(keepends=True))
    try:
        return any("\n" in cell for row in reader for cell in row[:-1]) and '"' in text
    except csv.Error:
        return False


def detect_encoding(path: Path, head: bytes) -> str:
    """Return the encoding of a text's beginning.

    Raises:
        FileError: it is not text.

    """
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if b"\0" in head:
        raise fault(
            path, "is a binary file, not text", "Name its device, or export it as text.", byte=head.index(b"\0")
        )
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"


def split_line(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line, without blanks around them and without the empty one after a last delimiter."""
    if delimiter == " ":
        line = line.replace("\t", " ").strip()
    try:
        cells = [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]
    except csv.Error:
        cells = [cell.strip() for cell in line.split(delimiter)]
    # one idle delimiter at the end, as some loggers write; two are empty cells
    idle = len(cells) > 1 and not cells[-1] and cells[-2] != ""
    return cells[:-1] if idle else cells


def _counts(cells: list[str], decimal: str) -> tuple[int, int]:
    """Numbers and words in a row; up to four words before the first number are names, not counted."""
    kinds = [parse_number(cell, decimal) is not None for cell in cells if cell]
    names = min(4, next((i for i, is_number in enumerate(kinds) if is_number), 0))
    return sum(kinds), len(kinds) - sum(kinds) - names


def _is_data(cells: list[str], decimal: str) -> bool:
    numbers, words = _counts(cells, decimal)
    return numbers >= 2 and numbers > words


def _score(lines: list[str], delimiter: str, decimal: str) -> float:
    """Numbers found in rows of the commonest width; text among them counts against."""
    rows = [split_line(line, delimiter) for line in lines if line.strip() and not line.lstrip().startswith(COMMENTS)]
    data = [row for row in rows if _is_data(row, decimal)]
    if not data:
        return 0.0
    width = Counter(len(row) for row in data).most_common(1)[0][0]
    alike = [row for row in data if len(row) == width]
    numbers = sum(_counts(row, decimal)[0] for row in alike)
    words = sum(_counts(row, decimal)[1] for row in alike)
    return numbers - 1.5 * words + len(alike)


def _layout(path: Path, lines: list[str], encoding: str, delimiter: str, decimal: str) -> TextLayout:
    rows = [[] if line.lstrip().startswith(COMMENTS) else split_line(line, delimiter) for line in lines]
    data = [i for i, row in enumerate(rows) if _is_data(row, decimal)]
    width = Counter(len(rows[i]) for i in data).most_common(1)[0][0]
    first = next(i for i in data if len(rows[i]) == width)
    above = [(i, row) for i, row in enumerate(rows[:first]) if any(row)]
    units: tuple[str | None, ...] = (None,) * width
    if above and len(above[-1][1]) <= width and _is_units(above[-1][1]):
        row = above.pop()[1]
        units = tuple(_unit(cell) for cell in row) + (None,) * (width - len(row))
    heading = above[-1][1] if above and _is_heading(above[-1][1], width, decimal) else None
    names = heading or [f"column {i + 1}" for i in range(width)]
    told = [name_and_unit(name) for name in (names + [""] * width)[:width]]
    return TextLayout(
        encoding,
        delimiter,
        decimal,
        first + 1,
        tuple(name for name, _ in told),
        tuple(found or units[i] for i, (_, found) in enumerate(told)),
        tuple(tuple(split_line(line, delimiter)) for line in lines[:first] if line.strip()),
        width,
        heading is not None,
    )


def _is_heading(row: list[str], width: int, decimal: str) -> bool:
    words = [cell for cell in row if cell and parse_number(cell, decimal) is None]
    return width - 1 <= len(row) <= width + 1 and len(words) > len(row) / 2


def _is_units(row: list[str]) -> bool:
    said = [cell for cell in row if cell]
    return bool(said) and sum(_unit(cell) is not None for cell in said) > len(said) / 2 and len(said) >= 2


def _unit(cell: str) -> str | None:
    return UNITS.get(cell.strip("[]() ").lower())


def name_and_unit(name: str) -> tuple[str, str | None]:
    """Split ``X [mm]``, ``X (mm)``, ``X_mm`` or ``X/mm`` into the name and its unit, None when it states none."""
    match = IN_NAME.search(name)
    if match and match[1].lower() in UNITS:
        return name[: match.start()].strip(), UNITS[match[1].lower()] or None
    for sign in ("_", "/", " "):
        stem, found, unit = name.rpartition(sign)
        if found and stem and unit.lower() in UNITS and len(unit) > (0 if unit in ("m", "s") else 1):
            return stem.strip(), UNITS[unit.lower()] or None
    return name.strip(), None


def unknown_unit(name: str) -> str:
    """What stands in brackets behind a name as units do and is none of those known: ``ft`` of ``X [ft]``; else nothing."""
    match = IN_NAME.search(name)
    said = match[1] if match else ""
    return said if said.isalpha() and len(said) <= LONGEST_UNIT and said.lower() not in UNITS else ""
