"""Corrections as they go over the wire: limits of the contract into core's, what was removed into columns in mm."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kilter_service.contract.versions import CorrectionLimits
from kilter_service.correction.outcome import flag_names
from kilter_service.wire import to_deg, to_mm

if TYPE_CHECKING:
    import pyarrow as pa

    from kilter_core.correct.program import CorrectionOptions
    from kilter_service.correction.outcome import Outcome

Floats = NDArray[np.float64]


def options_of(
    limits: CorrectionLimits, temperature_c: float | None, task: str | None = None, at_limit: str | None = None
) -> CorrectionOptions:
    """Return how to correct within the limits of a version, the arm at this temperature.

    ``task`` None is the default of the core, ``at_limit`` None what the limits say: as the stream has both.
    """
    from kilter_core.correct.program import (
        CorrectionOptions,
    )  # loads compiled kernels: not at the start of the API process

    options = CorrectionOptions(
        largest_rad=math.radians(limits.max_joint_deg),
        largest_m=limits.max_position_mm * 1e-3,
        farthest_m=limits.max_position_mm * 1e-3,
        temperature_c=temperature_c,
        at_limit=limits.at_limit,
    )
    wanted: dict[str, Any] = {"task": task, "at_limit": at_limit}
    return replace(options, **{name: value for name, value in wanted.items() if value is not None})


def with_verdict(table: pa.Table, found: Outcome) -> pa.Table:
    """Add to a trajectory what was removed of the error, what is left, half the interval that holds it, and the status."""
    import pyarrow as pa

    done = found.done
    columns = _along("d", done.error_removed) | {"left_mm": cells(to_mm(found.left))} | _along("left_", done.left)
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
    import pyarrow as pa

    return pa.array(values, pa.float64(), mask=np.isnan(values))
