"""Parquet files: contract columns, or a lab's own."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.reader import MAP, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.formats.tables.parquet import read_parquet
from kilter_files.ground.units import column_unit
from kilter_files.tables.source import Source

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
