"""Trajectories as CSV, Parquet or JSON."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from kilter_core.errors import ObservationError
from kilter_service.contract.columns import LOAD_PARTS, PAYLOAD_CENTRE
from kilter_service.ground.limits import MAX_TRAJECTORY_CELLS, MAX_TRAJECTORY_ROWS
from kilter_service.ground.tables import reading
from kilter_service.ground.tables.columns import Column, read_columns

if TYPE_CHECKING:
    import pyarrow as pa

# What a trajectory may say; whatever else a file of observations has is a measurement.
QUANTITIES = frozenset(
    {
        "q",
        "qd",
        "qdd",
        "dir",
        "t",
        "payload",
        *PAYLOAD_CENTRE,
        "temperature",
        "base_tilt_x",
        "base_tilt_y",
        *LOAD_PARTS[0],
        "session",
        "pose_id",
        "row",
    }
)


def read_trajectory(
    path: Path, media: str, kinds: Sequence[str], most_rows: int = MAX_TRAJECTORY_ROWS
) -> tuple[pa.Table, tuple[Column, ...]]:
    """Read a trajectory for joints of these ``kinds``.

    Raises:
        ObservationError: as for an upload; or a column that does not belong to a trajectory, or an empty cell.

    """
    columns = read_columns(reading.column_names(path, media), kinds)
    for column in columns:
        if column.quantity in ("fx", "mx", "load_fx", "load_mx"):
            raise ObservationError(
                f"Column {column.name!r}: a correction does not know forces yet to come, only masses. Leave "
                "the column out; what the force bends stays uncorrected.",
                column=column.name,
            )
        if column.quantity not in QUANTITIES:
            raise ObservationError(
                f"Column {column.name!r} is a measurement: leave it out of a trajectory.", column=column.name
            )
    table = reading.whole_table(path, media, min(most_rows, MAX_TRAJECTORY_CELLS // len(columns)))
    for column in columns:
        if table.column(column.name).null_count:
            row = int(table.column(column.name).is_null().to_numpy().argmax()) + 1
            raise ObservationError(
                f"Row {row}, column {column.name!r} is empty: give every cell.", row=row, column=column.name
            )
    return table, columns
