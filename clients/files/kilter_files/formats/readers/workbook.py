"""Sheets of workbooks."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.reader import MAP, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.formats.tables.workbook import read_xlsx
from kilter_files.formats.unknown.understood import describe_table
from kilter_files.ground.errors import FileError
from kilter_files.ground.units import column_unit
from kilter_files.tables.source import Layout, Source


class Workbook(Reader[Source]):
    """A sheet as columns by name."""

    name = "xlsx"
    title = "a sheet of a workbook"
    use = MAP
    endings = (".xlsx", ".xlsm")
    is_a = "a workbook"
    instead = "Send contract columns with kilter upload, others with a column map."

    def recognises(self, head: Head) -> bool:
        """A ZIP archive that is called a workbook."""
        return head.start.startswith(b"PK\x03\x04") and head.ending in self.endings

    def describe(self, head: Head) -> Document:
        """Columns of the sheet with the table; ready when those of the first sheet are the contract's."""
        return describe_table(head) | {"ready": _is_contract(head.path)}

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Source:
        """Read a sheet."""
        return read_xlsx(path, hints.layout)


def _is_contract(path: Path) -> bool:
    """Whether the first sheet holds contract columns only."""
    try:
        names = [name for name in read_xlsx(path, Layout()).choices if name]
    except FileError:
        return False
    return bool(names) and all(column_unit(name) is not None for name in names)


READER = Workbook()
