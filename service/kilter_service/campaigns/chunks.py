"""Rows as compressed Parquet files with their SHA-256, the form in which they are stored."""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from kilter_files.ground.later import parquet
from kilter_service.ground.errors import ServiceError

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Chunk:
    """A Parquet file beside the upload, its rows and its hash; its bytes are read when it is stored."""

    path: Path
    rows: int
    sha256: str


def write_chunk(table: pa.Table, path: Path) -> Chunk:
    """Write rows as Parquet (zstd)."""
    parquet.write_table(table, path, compression="zstd")
    return Chunk(path, table.num_rows, hashlib.sha256(path.read_bytes()).hexdigest())


def read_chunk(blob: bytes, sha256: str) -> pa.Table:
    """Read the rows of a stored chunk.

    Raises:
        ServiceError: the bytes are no longer those that were stored.

    """
    if hashlib.sha256(blob).hexdigest() != sha256:
        raise ServiceError(
            f"Stored observations are damaged (chunk {sha256[:12]}): restore the database from a backup."
        )
    return parquet.ParquetFile(io.BytesIO(blob)).read(use_threads=False)  # read_table imports datasets, 8 MB
