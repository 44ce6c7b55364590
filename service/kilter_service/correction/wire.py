"""Corrections as they go over the wire: what was removed into columns in mm."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kilter_core.types import Floats
from kilter_files.ground.later import pa
from kilter_service.ground.correction_outcome import flag_names
from kilter_service.ground.wire import to_deg, to_mm

if TYPE_CHECKING:
    from kilter_service.ground.correction_outcome import Outcome


def with_verdict(table: pa.Table, found: Outcome) -> pa.Table:
    """Add to a trajectory what was removed of the error, what is left, half the interval that holds it, and the status."""
    done = found.done
    columns = (
        _along("d", done.error_removed) | {"left_mm": cells(to_mm(found.remaining_errors))} | _along("left_", done.left)
    )
    if found.turns:
        columns["left_deg"] = cells(to_deg(done.left_rad))
    columns |= _along("u95_", found.u95)
    columns["flags"] = pa.array([flag_names(one) for one in done.flags.tolist()], pa.string())
    columns["status"] = pa.array(found.words, pa.string())
    for name, column in columns.items():
        table = table.append_column(name, column)
    return table


def _along(name: str, values: Floats) -> dict[str, pa.Array]:
    """Columns in mm of vectors (N, 3) m."""
    return {f"{name}{axis}_mm": cells(to_mm(values[:, k])) for k, axis in enumerate("xyz")}


def cells(values: Floats) -> pa.Array:
    """Return a column; a cell without a number is empty."""
    return pa.array(values, pa.float64(), mask=np.isnan(values))
