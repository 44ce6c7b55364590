"""A file as columns by name, whatever its format, and how a text is laid out.

Cells of a text or a sheet as columns by name.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence, Sized
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from kilter_files.ground.cell_numbers import element, elements, parse_element_name, parse_number
from kilter_files.ground.errors import FileError, did_you_mean
from kilter_files.ground.time_stamps import parse_stamp


@dataclass(frozen=True)
class Layout:
    """How the text is laid out."""

    delimiter: str = ","
    decimal: str = "."
    encoding: str = "utf-8-sig"
    skip_rows: int = 0
    header: bool = True
    comment: str = ""
    missing: tuple[str | float, ...] = ()
    units_row: bool = False
    sheet: str | int | None = None
    rows_per_pose: int = 1

    @property
    def missing_numbers(self) -> tuple[float, ...]:
        """The numbers that stand for "missing", for formats that hold numbers."""
        return tuple(value for value in self.missing if isinstance(value, float))


class Source(Protocol):
    """A file as columns by name."""

    @property
    def path(self) -> Path:
        """The file."""

    @property
    def lines(self) -> list[int]:
        """The line of each row; empty when rows have none."""

    @property
    def choices(self) -> list[str]:
        """What ``from`` may name."""

    def texts(self, name: str | int) -> list[str]:
        """Return a column as text."""

    def numbers(self, name: str | int) -> list[float]:
        """Return a column as numbers, NaN where nothing was measured."""


def row_line_numbers(source: Source, rows: Sized) -> list[int]:
    """Return the line of each of ``rows``: that in the file, else its number."""
    return source.lines or list(range(1, len(rows) + 1))


LINES_IN_NAME = re.compile(r"\s*[\r\n]+\s*")


@dataclass
class TextSource:
    """A read text file: named columns of cells, and the line of each row."""

    path: Path
    layout: Layout
    names: list[str]
    cells: list[list[str]]
    lines: list[int]
    _index: dict[str, int] = field(init=False)

    def __post_init__(self) -> None:
        self._index = {name: i for i, name in enumerate(self.names)}

    @property
    def choices(self) -> list[str]:
        """What ``from`` may name: the columns, and the elements of those whose cells are lists."""
        first = self.cells[0] if self.cells else []
        decimal = self.layout.decimal
        lists = {name: elements(name, cell, decimal) for name, cell in zip(self.names, first, strict=False)}
        return [choice for name in self.names for choice in (name, *lists.get(name, []))]

    def row_location(self, line: int) -> str:
        """Say where a row is, for messages."""
        return f"line {line}"

    def place(self, row: int, name: str | int) -> str:
        """Say where a cell is, for messages."""
        return f"{self.row_location(self.lines[row])}, column {name!r}"

    def has(self, name: str | int) -> bool:
        """Tell whether there is such a column."""
        return name in self._index if isinstance(name, str) else 0 <= name < len(self.names)

    def texts(self, name: str | int) -> list[str]:
        """Return the cells of a column, by name or by index from 0; ``q[0]`` is an element of a column of lists.

        Raises:
            FileError: no such column.

        """
        if not self.has(name):
            return self._element(name)
        index = self._index[name] if isinstance(name, str) else name
        return [row[index].strip() for row in self.cells]

    def _element(self, name: str | int) -> list[str]:
        found = parse_element_name(name) if isinstance(name, str) else None
        if found is None or not self.has(found[0]):
            raise FileError(
                f"{self.path}: there is no column {name!r}{did_you_mean(str(name), self.names)}; "
                f"the file has {', '.join(self.names)}.",
                file=str(self.path),
                column=name,
            )
        return element(self.texts(found[0]), found[1], self.layout.decimal, lambda row, why: self.wrong(row, name, why))

    def wrong(self, row: int, name: str | int, why: str, remedy: str = "Correct the cell.") -> FileError:
        """Build the refusal of a cell."""
        return FileError(
            f"{self.path}, {self.place(row, name)}: {why}. {remedy}",
            file=str(self.path),
            line=self.lines[row],
            column=name,
        )

    def numbers(self, name: str | int) -> list[float]:
        """Return a column as numbers, NaN where a cell is empty or stands for "missing".

        Raises:
            FileError: no such column, or a cell that is not a number (line and column named).

        """
        missing = {str(m) for m in self.layout.missing}
        values = []
        for row, text in enumerate(self.texts(name)):
            value = math.nan if text in missing else parse_number(text, self.layout.decimal)
            if value is None:
                why = f"{text[:40]!r} is not a number with decimal '{self.layout.decimal}'"
                raise self.wrong(row, name, why, self._remedy(name, text))
            values.append(value)
        return values

    def _remedy(self, name: str | int, text: str) -> str:
        if elements(str(name), text, self.layout.decimal):
            return f'The cell is a list: name one element, for example from = "{name}[0]".'
        if parse_stamp(text) is not None:
            return 'It is a time stamp: map it to t_s with unit = "timestamp".'
        return "Correct the cell, set 'decimal', or list the text under 'missing'."


def header_names(path: Path, cells: Sequence[str]) -> list[str]:
    """Return the names of a header's cells, each on one line.

    Raises:
        FileError: a name that stands twice.

    """
    names = [LINES_IN_NAME.sub(" ", cell.strip()) for cell in cells]
    twice = next((name for i, name in enumerate(names) if name and name in names[:i]), None)
    if twice is not None:
        raise FileError(f"{path}: two columns are called {twice!r}. Rename one.", file=str(path), column=twice)
    return names
