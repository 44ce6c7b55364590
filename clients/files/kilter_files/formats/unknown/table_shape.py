"""How an unknown table is laid out, whatever its format: what a column map says under [file], and the file read so."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from kilter_files.formats.registry import endings, open_source
from kilter_files.formats.tables.workbook import read_xlsx, sheet_names
from kilter_files.ground.cell_numbers import parse_list, parse_number
from kilter_files.ground.errors import FileError, fault, read_head
from kilter_files.ground.text_layout import COMMENTS, UNITS, detect_encoding, name_and_unit, unknown_unit
from kilter_files.ground.time_stamps import parse_stamp
from kilter_files.tables.source import Layout, Source, header_names

SAMPLE_BYTES = 1 << 20
SAMPLE_ROWS = 400
SELDOM, MOST_WORDS = 0.2, 2  # share of the cells of a column, and different ones, that may be words for "not measured"
TRIES = ((";", ","), (";", "."), ("\t", ","), ("\t", "."), (",", "."), ("|", "."), (" ", "."), (" ", ","))
Row = tuple[int, list[str]]


@dataclass(frozen=True)
class TableShape:
    """An unknown file: its format, layout, columns as a map may name them, and the units that stand beside their names.

    ``strange`` are those beside names that are none of the units known.
    """

    path: Path
    form: str
    layout: Layout
    source: Source
    units: dict[str, str | None] = field(default_factory=dict)
    strange: dict[str, str] = field(default_factory=dict)


def detect_table_shape(path: Path) -> TableShape:
    """Find out how a file is laid out and read it.

    Raises:
        FileError: an ending no format has, no table, or a damaged one.

    """
    form = endings().get(path.suffix.lower(), "csv")
    if form == "csv":
        layout, units = _text(path)
    elif form == "xlsx":
        layout, units = _workbook(path)
    else:
        layout, units = Layout(), {}
    source = open_source(path, form, layout)
    if form in ("csv", "xlsx") and (words := _missing(source, layout.decimal)):
        layout = replace(layout, missing=words)
        source = open_source(path, form, layout)
    told = {name: name_and_unit(name.partition("[" if form == "mat" else "\0")[0])[1] for name in source.choices}
    strange = {} if form == "mat" else {name: unknown_unit(name) for name in source.choices}
    return TableShape(
        path, form, layout, source, {name: units.get(name) or told[name] for name in source.choices}, strange
    )


def _missing(source: Source, decimal: str) -> tuple[str, ...]:
    """Words that stand for "not measured" in columns of numbers: one or two, in few of their cells."""
    found: set[str] = set()
    for name in source.choices:
        cells = [cell for cell in source.texts(name) if cell] if name else []
        words = [cell for cell in cells if parse_number(cell, decimal) is None]
        if (
            0 < len(words) <= SELDOM * len(cells)
            and len(set(words)) <= MOST_WORDS
            and not any(map(_holds_digit, words))
        ):
            found |= set(words)
    return tuple(sorted(found))


def _holds_digit(word: str) -> bool:
    return any(letter.isdigit() for letter in word)


def _text(path: Path) -> tuple[Layout, dict[str, str | None]]:
    head = read_head(path, SAMPLE_BYTES)
    encoding = detect_encoding(path, head)
    text = head.decode(encoding, "ignore")
    rows = {delimiter: _rows(text, delimiter) for delimiter, _ in TRIES}
    delimiter, decimal = max(TRIES, key=lambda pair: _score(rows[pair[0]], pair[1]))
    if _score(rows[delimiter], decimal) <= 0:
        raise fault(
            path, "no table of numbers was found in its beginning", "Export it as CSV with a line of names above."
        )
    head_line, header, units_row, comment, units = _head(path, rows[delimiter], decimal)
    layout = Layout(delimiter, decimal, encoding, head_line - 1, header, comment, (), units_row)
    return replace(layout, rows_per_pose=4) if _are_matrices(rows[delimiter], layout) else layout, units


def _are_matrices(rows: Sequence[Row], layout: Layout) -> bool:
    """Whether every fourth row is 0, 0, 0, 1, as in blocks of 4 x 4 matrices."""
    kept = [cells for line, cells in rows if line > layout.skip_rows]
    kept = [cells for cells in kept if not (layout.comment and cells[0].startswith(layout.comment))]
    whole = kept[: len(kept) // 4 * 4]
    if layout.header or len(whole) < 8 or any(len(cells) != 4 for cells in whole):
        return False
    return all([parse_number(cell, layout.decimal) for cell in cells] == [0, 0, 0, 1] for cells in whole[3::4])


def _workbook(path: Path) -> tuple[Layout, dict[str, str | None]]:
    best: tuple[float, Layout, list[Row]] | None = None
    for sheet in sheet_names(path):
        layout = Layout(header=False, sheet=sheet)
        try:
            found = read_xlsx(path, layout)
        except FileError as error:
            if "holds no rows" not in error.detail:
                raise
            continue
        rows = list(zip(found.lines, found.cells, strict=True))[:SAMPLE_ROWS]
        for decimal in (".", ","):
            local = [
                (line, [cell.replace(".", decimal) if _is_float(cell) else cell for cell in row]) for line, row in rows
            ]
            score = _score(local, decimal) - (0.1 if decimal == "," else 0.0)
            if best is None or score > best[0]:
                best = (score, replace(layout, decimal=decimal, delimiter=";"), local)
    if best is None or best[0] <= 0:
        raise fault(
            path, "no table of numbers was found in its sheets", "Put the names of the columns above the numbers."
        )
    head_line, header, units_row, comment, units = _head(path, best[2], best[1].decimal)
    return replace(best[1], skip_rows=head_line - 1, header=header, units_row=units_row, comment=comment), units


def _is_float(cell: str) -> bool:
    return "." in cell and parse_number(cell) is not None


def _rows(text: str, delimiter: str) -> list[Row]:
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, skipinitialspace=delimiter == " ")
    out: list[Row] = []
    before = 0
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if any(cells):
                out.append((before + 1, cells))
            before = reader.line_num
            if len(out) > SAMPLE_ROWS:
                break
    except csv.Error:
        pass
    return out[:-1] if len(out) > SAMPLE_ROWS else out


def _kinds(cells: Sequence[str], decimal: str) -> tuple[int, int]:
    """Cells that hold values (numbers, lists, time stamps), and words."""
    said = [cell for cell in cells if cell]
    lists = sum(parse_list(cell, decimal) is not None for cell in said)
    values = sum(parse_number(cell, decimal) is not None or parse_stamp(cell) is not None for cell in said)
    return values + 3 * lists, len(said) - values - lists


def _is_data(cells: Sequence[str], decimal: str) -> bool:
    values, words = _kinds(cells, decimal)
    return values >= 2 and values > words and not cells[0].startswith(COMMENTS)


def _score(rows: Sequence[Row], decimal: str) -> float:
    data = [cells for _, cells in rows if _is_data(cells, decimal)]
    if not data:
        return 0.0
    width = Counter(map(len, data)).most_common(1)[0][0]
    alike = [_kinds(cells, decimal) for cells in data if len(cells) == width]
    ragged = len(data) - len(alike)
    return sum(values - 1.5 * words for values, words in alike) + len(alike) - 3.0 * ragged


def _head(path: Path, rows: Sequence[Row], decimal: str) -> tuple[int, bool, bool, str, dict[str, str | None]]:
    """Line of the header (or of the first row), whether there is one, a row of units below it, the sign of comments."""
    data = [k for k, (_, cells) in enumerate(rows) if _is_data(cells, decimal)]
    width = Counter(len(rows[k][1]) for k in data).most_common(1)[0][0]
    first = next(k for k in data if len(rows[k][1]) == width)
    above = list(rows[:first])
    signs = [cells[0][:1] for _, cells in rows[first:] if cells[0].startswith(COMMENTS)]
    comment = signs[0] if signs else ""
    units: list[str] = []
    if len(above) > 1 and _is_units(above[-1][1]):
        units = above.pop()[1]
    named = bool(above) and abs(len(above[-1][1]) - width) <= 1 and _kinds(above[-1][1], decimal)[1] > 0
    if not named:
        return rows[first][0], False, False, comment, {}
    names = header_names(path, above[-1][1])
    told = {name: UNITS.get(unit.strip("[]() ").lower()) or None for name, unit in zip(names, units, strict=False)}
    return above[-1][0], True, bool(units), comment, told


def _is_units(cells: Sequence[str]) -> bool:
    said = [cell for cell in cells if cell]
    return len(said) >= 2 and sum(cell.strip("[]() ").lower() in UNITS for cell in said) > len(said) / 2
