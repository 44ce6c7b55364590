"""A file as columns by name, whatever its format, and how a text is laid out."""

from __future__ import annotations

from collections.abc import Sized
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol


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
