"""Formulas of a workbook that no program has computed: a script writes the formula only, and its value reads as empty.

Zip archives, as workbooks are: what is in one and how much it unpacks to, looked at before anything is unpacked.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

SHOWN = 5
REMEDY = "Open the workbook in a spreadsheet program and save it there, or let the script write numbers."
Cell = tuple[int, int]  # row and column, from 1


def formulas_without_value(openpyxl: Any, path: Path, sheet: int, last_row: int | None = None) -> list[Cell]:
    """Return the cells of a sheet (its number from 0) that hold a formula and no stored value, row by row.

    A formula whose stored value is an empty text is not among them.
    """
    found = {
        (row, column)
        for row, cells in _rows(openpyxl, path, sheet, last_row, data_only=False, values_only=True)
        for column, value in enumerate(cells, 1)
        if not isinstance(value, int | float) and str(value).startswith(("=", "<openpyxl"))
    }
    if not found:
        return []
    return [
        (row, column)
        for row, cells in _rows(openpyxl, path, sheet, last_row, data_only=True, values_only=False)
        for column, cell in enumerate(cells, 1)
        if (row, column) in found and cell.value is None and cell.data_type != "str"
    ]


def describe_cells(cells: Sequence[Cell]) -> str:
    """Name the cells of formulas without a value, as a spreadsheet program does."""
    names = ", ".join(f"{letters(column)}{row}" for row, column in cells[:SHOWN])
    more = f" and {len(cells) - SHOWN} more" if len(cells) > SHOWN else ""
    if len(cells) == 1:
        return f"cell {names} holds a formula without a computed value"
    return f"cells {names}{more} hold formulas without computed values"


def letters(number: int) -> str:
    """Return the letters of a column's number from 1: A, B, ..., Z, AA, ..."""
    out = ""
    while number:
        number, rest = divmod(number - 1, 26)
        out = chr(ord("A") + rest) + out
    return out


def _rows(
    openpyxl: Any, path: Path, sheet: int, last_row: int | None, *, data_only: bool, values_only: bool
) -> Iterator[tuple[int, Any]]:
    book = openpyxl.load_workbook(path, read_only=True, data_only=data_only)
    try:
        yield from enumerate(book.worksheets[sheet].iter_rows(values_only=values_only, max_row=last_row), 1)
    finally:
        book.close()


def unpacked_bytes(path: Path) -> int:
    """Return how many bytes an archive says that it unpacks to.

    Raises:
        ValueError: it cannot be read as one; its text says why.

    """
    return sum(item.file_size for item in _member_infos(path))


def member_names(path: Path) -> list[str]:
    """Return the names in an archive; those of folders end in a slash.

    Raises:
        ValueError: it cannot be read as one; its text says why.

    """
    return [item.filename for item in _member_infos(path)]


def _member_infos(path: Path) -> list[zipfile.ZipInfo]:
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.infolist()
    except (OSError, NotImplementedError, zipfile.BadZipFile) as error:  # a zip of a version nobody has yet
        raise ValueError(str(error)) from error
