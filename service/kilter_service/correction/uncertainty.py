"""How far the tool of the corrected arm may be from where it should be, row by row."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kilter_service.correction.follow import Corrected, last_motion
from kilter_service.corrector.frames import Status

if TYPE_CHECKING:
    from kilter_core.identify.uncertainty.predictive import Predictive
    from kilter_core.model import Calibration
    from kilter_core.observations import Observations

Floats = NDArray[np.float64]


def uncertainty(
    calibration: Calibration,
    rows: Observations,
    done: Corrected,
    known: Predictive | None,
    temperature_c: float | None = None,
) -> Floats:
    """Half widths (N, 3) m of the 95 % intervals of the corrected rows, along the axes of the wanted base.

    NaN for rows that were refused, and everywhere when nothing is ``known`` of the version. An effect that is left out of
    the correction is left out here.
    """
    out = np.full((len(rows), 3), np.nan)
    good = done.status == Status.OK
    if known is None or not good.any():
        return out
    there = replace(rows, q=done.q, direction=last_motion(rows.q) if rows.direction is None else rows.direction)
    if rows.temperature_c is None and temperature_c is not None:
        there = replace(there, temperature_c=np.full(len(rows), temperature_c))
    corrected = [e for key, e in zip(calibration.model.effect_slices(), calibration.model.effects, strict=True)
                 if key not in done.not_corrected]  # fmt: skip
    arm = calibration.with_effects(corrected)
    axes = arm.wanted().model.T_base[:3, :3]
    out[good] = known.of_the_tool(arm, there.select(good), axes)
    return out
