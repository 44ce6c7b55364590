"""Views as Parquet: the columns of their CSV file, numbers as numbers, some rows in memory at a time."""

from __future__ import annotations

import csv
from pathlib import Path

from kilter_files.ground.faults import missing_package
from kilter_files.ground.units import NAMES

BLOCK_BYTES = 1 << 24  # of the CSV file, read at once


def check_pyarrow(output: Path) -> None:
    """Refuse before any picture is read.

    Raises:
        MissingPackageError: pyarrow is not installed.

    """
    try:
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise missing_package(output, "Parquet files", "pyarrow") from error


def write_parquet(views: Path, output: Path) -> None:
    """Write the rows of a CSV file of views; empty cells are null."""
    from pyarrow import csv as reading
    from pyarrow import float64, parquet, string

    with views.open(encoding="utf-8", newline="") as stream:
        names = next(csv.reader(stream))
    convert = reading.ConvertOptions(
        column_types={name: string() if name in NAMES else float64() for name in names}, null_values=[""]
    )
    rows = reading.open_csv(views, reading.ReadOptions(block_size=BLOCK_BYTES), convert_options=convert)
    with parquet.ParquetWriter(output, rows.schema, compression="zstd") as writer:
        for batch in rows:
            writer.write_batch(batch)
