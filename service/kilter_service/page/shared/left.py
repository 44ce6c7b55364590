"""What a version leaves of every row of campaigns, as columns."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_service.db import Database
from kilter_service.tables.reading import PARQUET
from kilter_service.versions import service

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


def residuals(database: Database, version: str, chosen: Sequence[str]) -> dict[str, Any]:
    """Return what a version leaves of every row, as columns of the file that the interface gives."""
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(io.BytesIO(service.residuals(database, version, chosen, PARQUET)))
    return {name: table.column(name).to_numpy(zero_copy_only=False) for name in table.column_names}


def size_of(table: Mapping[str, Any]) -> Floats:
    """Length of the errors, mm; NaN where nothing was seen."""
    return np.asarray(np.sqrt(sum(np.asarray(table[f"d{axis}_mm"], dtype=np.float64) ** 2 for axis in "xyz")))
