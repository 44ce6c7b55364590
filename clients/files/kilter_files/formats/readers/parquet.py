"""Parquet files: contract columns, or a lab's own."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kilter_files.formats.reader import MAP, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.ground.cell_numbers import parse_element_name
from kilter_files.ground.errors import FileError, did_you_mean, fault
from kilter_files.ground.later import need, pa
from kilter_files.ground.later import parquet as arrow
from kilter_files.ground.units import column_unit
from kilter_files.tables.source import Source

MOST_CELLS = 30_000_000
MOST_BYTES = 1 << 30


@dataclass
class ParquetSource:
    """A read Parquet file. Rows have no lines: they are numbered from 1."""

    path: Path
    table: Any
    missing: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        self.names: list[str] = list(self.table.column_names)

    @property
    def lines(self) -> list[int]:
        """The row numbers, from 1."""
        return list(range(1, self.table.num_rows + 1))

    @property
    def choices(self) -> list[str]:
        """What ``from`` may name: the columns, and the elements of those that hold lists."""
        out: list[str] = []
        for name in self.names:
            first = next((value for value in self.table.column(name).slice(0, 1).to_pylist()), None)
            out += [name, *(f"{name}[{k}]" for k in range(len(first)))] if isinstance(first, list) else [name]
        return out

    def has(self, name: str | int) -> bool:
        """Tell whether there is such a column."""
        return name in self.names if isinstance(name, str) else 0 <= name < len(self.names)

    def texts(self, name: str | int) -> list[str]:
        """Return a column as text, for row filters."""
        return ["" if value is None else str(value) for value in self._column(name)]

    def numbers(self, name: str | int) -> list[float]:
        """Return a column as numbers, NaN where there is none.

        Raises:
            FileError: no such column, or one of text.

        """
        try:
            values = [math.nan if value is None else float(value) for value in self._column(name)]
        except (TypeError, ValueError) as error:
            raise FileError(
                f"{self.path}, column {name!r}: holds something else than numbers ({error}).",
                file=str(self.path),
                column=name,
            ) from error
        missing = set(self.missing)
        return [math.nan if value in missing else value for value in values]

    def _column(self, name: str | int) -> list[Any]:
        found = parse_element_name(name) if isinstance(name, str) and not self.has(name) else None
        if found is not None and self.has(found[0]):
            return self._element(*found)
        if not self.has(name):
            raise FileError(
                f"{self.path}: there is no column {name!r}{did_you_mean(str(name), self.names)}; "
                f"the file has {', '.join(self.names)}.",
                file=str(self.path),
                column=name,
            )
        return list(self.table.column(name).to_pylist())

    def _element(self, name: str, index: int) -> list[Any]:
        """One element of a column of lists; empty where there is no list."""
        lists = list(self.table.column(name).to_pylist())
        for row, value in enumerate(lists, 1):
            if value is not None and (not isinstance(value, list) or not index < len(value)):
                what = f"has no element {index} (from 0): it is {str(value)[:40]}"
                raise fault(self.path, what, "Correct it, or map another element.", row=row, column=name)
        return [None if value is None else value[index] for value in lists]


def _refuse_large(path: Path, stated: Any) -> None:
    cells = stated.num_rows * stated.num_columns
    unpacked = sum(stated.row_group(k).total_byte_size for k in range(stated.num_row_groups))
    if cells > MOST_CELLS or unpacked > MOST_BYTES:
        raise FileError(
            f"{path}: unpacks to {stated.num_rows} rows of {stated.num_columns} columns ({unpacked / 1e6:.0f} MB). "
            "Split it, or give contract columns, which are sent as they are.",
            file=str(path),
        )


def read_parquet(path: Path, missing: tuple[float, ...] = ()) -> ParquetSource:
    """Read a Parquet file with pyarrow.

    Raises:
        MissingPackageError: pyarrow is not installed.
        FileError: no Parquet file.

    """
    need(f"{path}: Parquet files need", "pyarrow")
    try:
        _refuse_large(path, arrow.read_metadata(path))
        return ParquetSource(path, arrow.read_table(path), missing)
    except (OSError, pa.ArrowException) as error:
        raise FileError(f"{path}: is not a Parquet file ({error}).", file=str(path)) from error


SHOWN = 20


class Parquet(Reader[Source]):
    """Columns by name."""

    name = "parquet"
    title = "Parquet"
    use = MAP
    endings = (".parquet",)
    is_a = "a Parquet file"
    instead = "Send contract columns with kilter upload, others with a column map."

    def recognises(self, head: Head) -> bool:
        """The first four bytes."""
        return head.start.startswith(b"PAR1")

    def describe(self, head: Head) -> Document:
        """Columns, and those that are not the contract's."""
        source = read_parquet(head.path)
        columns = [{"name": name, "unit": column_unit(name)} for name in source.names]
        odd = [name for name in source.names if column_unit(name) is None]
        warnings = [f"no contract columns: {', '.join(odd[:SHOWN])} (--draft writes a column map)"] if odd else []
        return {"rows": source.table.num_rows, "columns": columns, "warnings": warnings, "ready": not odd}

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Source:
        """Read the columns."""
        return read_parquet(path, hints.layout.missing_numbers)


READER = Parquet()
