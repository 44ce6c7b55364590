"""Views as Parquet: the columns of their CSV file, numbers as numbers, some rows in memory at a time."""

from __future__ import annotations

import csv
from pathlib import Path

from kilter_files.ground.later import csv as reading
from kilter_files.ground.later import need, pa, parquet
from kilter_files.ground.units import NAMES

BLOCK_BYTES = 1 << 24  # of the CSV file, read at once


def check_pyarrow(output: Path) -> None:
    """Refuse before any picture is read.

    Raises:
        MissingPackageError: pyarrow is not installed.

    """
    need(f"{output}: Parquet files need", "pyarrow")


def write_parquet(views: Path, output: Path) -> None:
    """Write the rows of a CSV file of views; empty cells are null."""
    with views.open(encoding="utf-8", newline="") as stream:
        names = next(csv.reader(stream))
    convert = reading.ConvertOptions(
        column_types={name: pa.string() if name in NAMES else pa.float64() for name in names}, null_values=[""]
    )
    rows = reading.open_csv(views, reading.ReadOptions(block_size=BLOCK_BYTES), convert_options=convert)
    with parquet.ParquetWriter(output, rows.schema, compression="zstd") as writer:
        for batch in rows:
            writer.write_batch(batch)
