"""Delimited text (CSV and its relatives) as columns by name."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from kilter_client.errors import FileError
from kilter_client.files.names import did_you_mean

NOT_A_NUMBER = ("nan", "na", "n/a", "null")


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

    def has(self, name: str | int) -> bool:
        """Tell whether there is such a column."""
        return name in self._index if isinstance(name, str) else 0 <= name < len(self.names)

    def texts(self, name: str | int) -> list[str]:
        """Return the cells of a column, by name or by index from 0.

        Raises:
            FileError: no such column.

        """
        if not self.has(name):
            raise FileError(
                f"{self.path}: there is no column {name!r}{did_you_mean(str(name), self.names)}; "
                f"the file has {', '.join(self.names)}.",
                file=str(self.path),
                column=name,
            )
        index = self._index[name] if isinstance(name, str) else name
        return [row[index].strip() for row in self.cells]

    def numbers(self, name: str | int) -> list[float]:
        """Return a column as numbers, NaN where a cell is empty or stands for "missing".

        Raises:
            FileError: no such column, or a cell that is no number (line and column named).

        """
        missing = {str(m) for m in self.layout.missing}
        values = []
        for text, line in zip(self.texts(name), self.lines, strict=True):
            value = math.nan if text in missing else parse_number(text, self.layout.decimal)
            if value is None:
                raise FileError(
                    f"{self.path}, line {line}, column {name!r}: {text!r} is no number with decimal "
                    f"'{self.layout.decimal}'. Correct the cell, set 'decimal', or list the text under 'missing'.",
                    file=str(self.path),
                    line=line,
                    column=name,
                )
            values.append(value)
        return values


def parse_number(text: str, decimal: str = ".") -> float | None:
    """Return the number of a cell, NaN for an empty one, None for text. A thousands separator is text."""
    if not text or text.lower() in NOT_A_NUMBER:
        return math.nan
    if "_" in text or (decimal != "." and "." in text):
        return None
    try:
        value = float(text.replace(decimal, ".", 1))
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def read_text(path: Path, layout: Layout) -> TextSource:
    """Read a delimited text file.

    Raises:
        FileError: unreadable, empty, a repeated column name, or a row with more or fewer cells than the header.

    """
    records = _records(path, layout)
    if not records:
        raise FileError(f"{path}: no rows. Export the measurement again, or lower 'skip_rows'.", file=str(path))
    if layout.header:
        (_, head), records = records[0], records[1:]
        names = [name.strip() for name in head]
        _refuse_repeated(path, names)
    else:
        names = [str(i) for i in range(len(records[0][1]))]
    _refuse_ragged(path, names, records, layout)
    return TextSource(path, layout, names, [row for _, row in records], [line for line, _ in records])


def _records(path: Path, layout: Layout) -> list[tuple[int, list[str]]]:
    try:
        with path.open(encoding=layout.encoding, newline="") as stream:
            for _ in range(layout.skip_rows):
                stream.readline()
            reader = csv.reader(stream, delimiter=layout.delimiter, skipinitialspace=layout.delimiter == " ")
            return [
                (layout.skip_rows + reader.line_num, row)
                for row in reader
                if any(cell.strip() for cell in row) and not (layout.comment and row[0].startswith(layout.comment))
            ]
    except (OSError, csv.Error) as error:
        raise FileError(f"{path}: cannot be read: {error}.", file=str(path)) from error
    except (UnicodeDecodeError, LookupError) as error:
        raise FileError(
            f"{path}: is not {layout.encoding} text ({error}). State its 'encoding', for example \"latin-1\".",
            file=str(path),
        ) from error


def _refuse_repeated(path: Path, names: Sequence[str]) -> None:
    twice = next((name for i, name in enumerate(names) if name in names[:i]), None)
    if twice is not None:
        raise FileError(f"{path}: two columns are called {twice!r}. Rename one.", file=str(path), column=twice)


def _refuse_ragged(path: Path, names: list[str], records: list[tuple[int, list[str]]], layout: Layout) -> None:
    for line, row in records:
        if len(row) != len(names):
            raise FileError(
                f"{path}, line {line}: {len(row)} cells where the header has {len(names)}. "
                f"Correct the row, or set 'delimiter' (now {layout.delimiter!r}).",
                file=str(path),
                line=line,
            )
