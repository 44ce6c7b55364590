"""The first sheet of an XLSX workbook, as text cells."""

from __future__ import annotations

from pathlib import Path

from kilter_files.ground.archives import unpacked_bytes
from kilter_files.ground.errors import FileError
from kilter_files.ground.later import need
from kilter_files.ground.workbook_formulas import REMEDY, describe_cells, formulas_without_value
from kilter_files.robots.sheet import Sheet

MAX_BYTES = 20_000_000  # unpacked: a table of a robot is a few kilobytes
MAX_ROWS = 200


def read_workbook(path: Path) -> Sheet:
    """Read the first sheet; values of formulas are those last computed.

    Raises:
        FileError: no workbook, or far bigger than a table of a robot.
        MissingPackageError: openpyxl is not installed.

    """
    openpyxl = need(f"{path}: Workbooks (.xlsx) need", "openpyxl", instead="save the sheet as CSV")
    _refuse_large(path)
    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        sheet = book.worksheets[0]
        found = list(enumerate(sheet.iter_rows(values_only=True, max_row=MAX_ROWS), 1))
        book.close()
        uncomputed = formulas_without_value(openpyxl, path, 0, MAX_ROWS)
    except Exception as error:  # of a damaged workbook openpyxl, zipfile, zlib and the XML parser each raise their own
        raise FileError(f"{path}: is not a workbook that can be read ({error}).", file=str(path)) from error
    if uncomputed:
        raise FileError(f"{path}: {describe_cells(uncomputed)}. {REMEDY}", file=str(path), line=uncomputed[0][0])
    rows = [(line, [_text(cell) for cell in cells]) for line, cells in found]
    return _sheet(path, [(line, cells) for line, cells in rows if any(cells)])


def _sheet(path: Path, rows: list[tuple[int, list[str]]]) -> Sheet:
    comments = [cells[0].lstrip("# ") for _, cells in rows if cells[0].startswith("#")]
    rows = [(line, cells) for line, cells in rows if not cells[0].startswith("#")]
    if not rows:
        raise FileError(f"{path}: its first sheet is empty.", file=str(path))
    width = max(k + 1 for k, cell in enumerate(rows[0][1]) if cell)
    return Sheet(path, rows[0][1][:width], [(line, cells[:width]) for line, cells in rows[1:]], comments)


def _text(cell: object) -> str:
    if cell is None:
        return ""
    return repr(cell) if isinstance(cell, float) else str(cell).strip()


def _refuse_large(path: Path) -> None:
    try:
        size = unpacked_bytes(path)
    except ValueError as error:
        raise FileError(f"{path}: is not an XLSX workbook ({error}).", file=str(path)) from error
    if size > MAX_BYTES:
        raise FileError(
            f"{path}: unpacks to {size / 1e6:.0f} MB; a robot's table is small. Save the one sheet by itself.",
            file=str(path),
        )
