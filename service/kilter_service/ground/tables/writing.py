"""A table as CSV, Parquet or JSON."""

from __future__ import annotations

import io
import json
from typing import TYPE_CHECKING

from kilter_files.ground.later import csv, parquet
from kilter_service.ground.tables.reading import CSV, PARQUET

if TYPE_CHECKING:
    import pyarrow as pa


def write_table(table: pa.Table, media: str) -> bytes:
    """Write a table in the format it came in; cells without a number are empty (CSV) or null."""
    buffer = io.BytesIO()
    if media == PARQUET:
        parquet.write_table(table, buffer, compression="zstd")
    elif media == CSV:
        csv.write_csv(table, buffer, csv.WriteOptions(quoting_style="needed"))
    else:
        buffer.write(json.dumps(table.to_pydict()).encode())
    return buffer.getvalue()
