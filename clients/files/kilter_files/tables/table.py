"""Measurements in contract columns, and their way to the server as bytes."""

from __future__ import annotations

import csv
import hashlib
import io
import math
from dataclasses import dataclass, field
from functools import cached_property

CSV_TYPE = "text/csv"
PARQUET_TYPE = "application/vnd.apache.parquet"
JSON_TYPE = "application/json"

WHOLE_NUMBERS = ("pose_id", "row", "session", "dir", "bar_id", "socket_id", "plane_id")


@dataclass
class Table:
    """Rows read from a foreign file: contract columns (NaN = not measured) and the line each row stood on."""

    columns: dict[str, list[float]]
    lines: list[int]
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.lines)

    def keep(self, index: list[int]) -> None:
        """Keep only the rows of ``index``, in that order."""
        self.columns = {name: [values[i] for i in index] for name, values in self.columns.items()}
        self.lines = [self.lines[i] for i in index]

    def to_csv(self) -> bytes:
        """Write the contract's CSV: every digit of every number, empty cells where nothing was measured."""
        out = io.StringIO(newline="")
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows(zip(*(cells(name, values) for name, values in self.columns.items()), strict=True))
        return out.getvalue().encode()


def cells(name: str, values: list[float]) -> list[str]:
    """Return the cells of a column: every digit of every number, an empty one where nothing was measured."""
    whole = name.startswith(WHOLE_NUMBERS)
    return ["" if math.isnan(v) else str(int(v)) if whole and v.is_integer() else repr(v) for v in values]


@dataclass(frozen=True)
class Prepared:
    """What is sent: the bytes, their type, and what was understood of the file they came from.

    ``rows`` and ``lines`` (the line of the file behind each row) are known only of converted files.
    """

    content: bytes
    content_type: str
    columns: tuple[str, ...] = ()
    rows: int | None = None
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    lines: tuple[int, ...] = ()

    @cached_property
    def sha256(self) -> str:
        """The content hash by which the server knows these bytes again."""
        return hashlib.sha256(self.content).hexdigest()

    @classmethod
    def from_table(cls, table: Table) -> Prepared:
        """Write a converted table as CSV bytes: the same file gives the same bytes everywhere."""
        return cls(
            table.to_csv(),
            CSV_TYPE,
            tuple(table.columns),
            len(table),
            tuple(table.notes),
            tuple(table.warnings),
            tuple(table.lines),
        )
