"""A sheet of an .xlsx workbook as columns by name; refusals name sheet and cell."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from kilter_files.ground.cell_numbers import parse_number
from kilter_files.ground.errors import FileError, did_you_mean, fault
from kilter_files.ground.later import need
from kilter_files.ground.workbook_formulas import (
    REMEDY,
    Cell,
    describe_cells,
    formulas_without_value,
    letters,
    unpacked_bytes,
)
from kilter_files.tables.source import Layout, TextSource, header_names

MOST_BYTES = 400_000_000  # unpacked
MOST_CELLS = 3_000_000
Row = tuple[int, list[str]]
Found = TypeVar("Found")


@dataclass
class XlsxSource(TextSource):
    """A read sheet: its cells as text, with the decimal sign of the layout."""

    sheet: str = ""
    uncomputed: Sequence[Cell] = ()  # cells of formulas that have no value

    def row_location(self, line: int) -> str:
        """Say where a row is: the sheet and its row."""
        return f"sheet {self.sheet!r}, row {line}"

    def texts(self, name: str | int) -> list[str]:
        """Return the cells of a column.

        Raises:
            FileError: no such column, or formulas in it that have no value.

        """
        if self.uncomputed and self.has(name):
            _refuse_uncomputed(self.path, self.sheet, self.uncomputed, self.column_number(name))
        return super().texts(name)

    def column_number(self, name: str | int) -> int:
        """Return the number of a column in the sheet, from 1."""
        return (name if isinstance(name, int) else self.names.index(name)) + 1

    def place(self, row: int, name: str | int) -> str:
        """Say where a cell is: sheet, cell and column."""
        index = self.names.index(name) if name in self.names else name if isinstance(name, int) else None
        cell = f"row {self.lines[row]}" if index is None else f"cell {letters(index + 1)}{self.lines[row]}"
        return f"sheet {self.sheet!r}, {cell}, column {name!r}"


def read_xlsx(path: Path, layout: Layout) -> XlsxSource:
    """Read one sheet (``layout.sheet``: its name or number from 0, default the first); formulas count as last computed.

    Raises:
        FileError: no workbook, no such sheet, an empty one, a name that stands twice.
        MissingPackageError: openpyxl is not installed.

    """
    title, rows, uncomputed = _rows(path, layout)
    width = max((len(cells) for _, cells in rows), default=0)
    kept = {number for number, _ in uncomputed}
    rows = [(number, cells + [""] * (width - len(cells))) for number, cells in rows if any(cells) or number in kept]
    rows = [row for row in rows if not (layout.comment and row[1][0].startswith(layout.comment))]
    if len(rows) < (2 if layout.header else 1):
        raise fault(
            path, f"sheet {title!r} holds no rows", "Choose another with 'sheet' under [file], or lower 'skip_rows'."
        )
    names = [str(i) for i in range(width)]
    if layout.header:
        _refuse_uncomputed(path, title, [cell for cell in uncomputed if cell[0] == rows[0][0]])
        names = header_names(path, rows[0][1])
        rows = rows[2:] if layout.units_row else rows[1:]
    numbers = [number for number, _ in rows]
    below = [cell for cell in uncomputed if cell[0] in set(numbers)]
    return XlsxSource(path, layout, names, [cells for _, cells in rows], numbers, sheet=title, uncomputed=below)


def sheet_names(path: Path) -> list[str]:
    """Return the names of a workbook's sheets.

    Raises:
        FileError: no workbook.
        MissingPackageError: openpyxl is not installed.

    """
    return _read_workbook(path, lambda book: [str(sheet.title) for sheet in book.worksheets])


def _refuse_uncomputed(path: Path, sheet: str, cells: Sequence[Cell], column: int | None = None) -> None:
    wrong = [cell for cell in cells if column in (None, cell[1])]
    if wrong:
        raise fault(path, f"sheet {sheet!r}: {describe_cells(wrong)}", REMEDY, line=wrong[0][0])


def _rows(path: Path, layout: Layout) -> tuple[str, list[Row], list[Cell]]:
    def read(book: Any) -> tuple[str, list[Row], list[Cell]]:
        sheet = _sheet(path, book, layout.sheet)
        found, cells = [], 0
        for number, row in enumerate(sheet.iter_rows(values_only=True), 1):
            cells += len(row)
            if cells > MOST_CELLS:
                raise fault(
                    path, f"sheet {sheet.title!r} has more than {MOST_CELLS} cells", "Save it as CSV or Parquet."
                )
            if number > layout.skip_rows:
                found.append((number, _texts(path, sheet.title, number, row, layout.decimal)))
        uncomputed = []
        if any("" in cells for _, cells in found):
            uncomputed = formulas_without_value(openpyxl, path, book.worksheets.index(sheet))
        return str(sheet.title), found, [cell for cell in uncomputed if cell[0] > layout.skip_rows]

    openpyxl = _openpyxl(path)
    return _read_workbook(path, read)


def _openpyxl(path: Path) -> Any:
    return need(f"{path}: Workbooks (.xlsx) need", "openpyxl")


def _read_workbook(path: Path, read: Callable[[Any], Found]) -> Found:
    openpyxl = _openpyxl(path)
    _refuse_large(path)
    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            return read(book)
        finally:
            book.close()
    except FileError:
        raise
    except Exception as error:  # of a damaged workbook openpyxl, zipfile, zlib and the XML parser each raise their own
        raise fault(path, f"is not a workbook that can be read ({error})", "Save it again, or as CSV.") from error


def _sheet(path: Path, book: Any, wanted: str | int | None) -> Any:
    names = [str(sheet.title) for sheet in book.worksheets]
    if isinstance(wanted, int) and 0 <= wanted < len(names):
        return book.worksheets[wanted]
    if wanted is not None and wanted not in names:
        what = f"has no sheet {wanted!r}{did_you_mean(str(wanted), names)}"
        raise fault(path, what, f"Its sheets are {', '.join(map(repr, names))}: correct 'sheet' under [file].")
    return book.worksheets[0 if wanted is None else names.index(str(wanted))]


def _texts(path: Path, sheet: str, number: int, row: Sequence[object], decimal: str) -> list[str]:
    out = []
    for column, value in enumerate(row, 1):
        if isinstance(value, str) and value.startswith("#") and value.endswith(("!", "?", "/A")):
            place = f"sheet {sheet!r}, cell {letters(column)}{number}"
            raise fault(path, f"{place} holds the error {value}", "Correct the formula and save again.", line=number)
        out.append(_text(value, decimal))
    return out


def _text(value: object, decimal: str) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value).replace(".", decimal)
    if isinstance(value, datetime.datetime | datetime.date | datetime.time):
        return value.isoformat()
    if isinstance(value, datetime.timedelta):
        return str(value)
    text = str(value).strip()
    if decimal == "," and parse_number(text, ".") is not None and parse_number(text, ",") is None:
        return text.replace(".", ",")
    return text


def _refuse_large(path: Path) -> None:
    try:
        size = unpacked_bytes(path)
    except ValueError as error:
        remedy = "Save it as .xlsx (an old .xls has another format), or as CSV."
        raise fault(path, f"is not an .xlsx workbook ({error})", remedy) from error
    if size > MOST_BYTES:
        raise fault(path, f"unpacks to {size / 1e6:.0f} MB", "Save the one sheet by itself, or as CSV or Parquet.")
