"""Corrections as they go over the wire: limits of the contract into core's, what was removed into columns in mm."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kilter_service.contract.versions import CorrectionLimits
from kilter_service.corrector.frames import Status

if TYPE_CHECKING:
    import pyarrow as pa

    from kilter_core.correct.program import CorrectionOptions
    from kilter_service.correction.follow import Corrected

Floats = NDArray[np.float64]


def options_of(limits: CorrectionLimits, temperature_c: float | None) -> CorrectionOptions:
    """Return how to correct within the limits of a version, the arm at this temperature."""
    from kilter_core.correct.program import (
        CorrectionOptions,
    )  # loads compiled kernels: not at the start of the API process

    return CorrectionOptions(
        largest_rad=math.radians(limits.max_joint_deg),
        largest_m=limits.max_position_mm * 1e-3,
        farthest_m=limits.max_position_mm * 1e-3,
        temperature_c=temperature_c,
    )


def with_verdict(table: pa.Table, done: Corrected, u95: Floats) -> pa.Table:
    """Add to a trajectory what was removed of the error, half the interval that is left, and the status."""
    removed = done.error_removed * 1e3
    for k, axis in enumerate("xyz"):
        table = table.append_column(f"d{axis}_mm", cells(removed[:, k]))
    for k, axis in enumerate("xyz"):
        table = table.append_column(f"u95_{axis}_mm", cells(u95[:, k] * 1e3))
    return table.append_column("status", [[Status(code).name for code in done.status.tolist()]])


def cells(values: Floats) -> pa.Array:
    """Return a column; a cell without a number is empty."""
    import pyarrow as pa

    return pa.array(values, pa.float64(), mask=np.isnan(values))
