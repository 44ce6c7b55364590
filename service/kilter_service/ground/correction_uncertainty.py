"""How far the tool of the corrected arm may be from where it should be, row by row."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from kilter_core.types import Floats
from kilter_files.ground.later import interpolate, special
from kilter_service.contract.stream_messages import Status

if TYPE_CHECKING:
    from kilter_core.correct.walker import CorrectedTrajectory
    from kilter_core.identify.uncertainty.predictive import Predictive
    from kilter_core.model import Calibration


LEVEL, TWO_SIDED, ONE_SIDED = 0.95, 1.959963984540054, 1.6448536269514722  # of the standard normal
FAR = 4.0  # biases in standard deviations beyond which the other side of the interval holds nothing
NODES = 401  # of the table of quantiles between


def from_parameters(
    calibration: Calibration,
    done: CorrectedTrajectory,
    known: Predictive | None,
    temperature_c: float | None = None,
) -> Floats:
    """Half widths (N, 3) m of the 95 % intervals that the parameters alone give, along the axes of the wanted base.

    NaN for rows that were refused, and everywhere when nothing is ``known`` of the version. An effect that is left out of
    the correction is left out here.
    """
    rows = done.wanted
    out = np.full((len(rows), 3), np.nan)
    good = done.status == Status.OK
    if known is None or not good.any():
        return out
    there = replace(rows, q=done.q, direction=done.direction)
    if rows.temperature_c is None and temperature_c is not None:
        there = replace(there, temperature_c=np.full(len(rows), temperature_c))
    corrected = [e for key, e in zip(calibration.model.effect_slices(), calibration.model.effects, strict=True)
                 if key not in done.not_corrected]  # fmt: skip
    arm = calibration.with_effects(corrected)
    axes = arm.wanted().model.T_base[:3, :3]
    out[good] = known.of_the_tool(arm, there.select(good), axes)
    return out


def about(bias: Floats, half: Floats) -> Floats:
    """Half widths w of the intervals -w to w that hold 95 % of a normal error with this mean and this own half width.

    What a correction leaves is known: it moves the error, and does not widen it. With b the ``bias``, s = ``half`` / 1.96
    and Phi the standard normal, w solves Phi((w - b) / s) - Phi((-w - b) / s) = 0.95, the quantile of a folded normal: it
    is ``half`` at b = 0 and |b| + 1.645 s far from it, less than their sum. (w / s)² is a quantile of the noncentral
    chi-squared distribution with one degree of freedom and noncentrality (b / s)².
    """
    size, sigma = np.abs(bias), half / TWO_SIDED
    away = np.divide(size, sigma, out=np.full_like(size, np.inf), where=sigma > 0.0)
    near = sigma * _quantiles()(np.minimum(away, FAR))
    found: Floats = np.where(away < FAR, near, size + ONE_SIDED * sigma)
    return np.where(np.isnan(bias) | np.isnan(half), np.nan, found)


@cache
def _quantiles() -> interpolate.CubicSpline:
    """Quantiles w / s over b / s, to 1e-9: the distribution itself takes seconds for a long trajectory."""
    away = np.linspace(0.0, FAR, NODES)
    return interpolate.CubicSpline(
        away, np.sqrt(special.chndtrix(LEVEL, 1.0, away**2)), bc_type=((1, np.zeros(())), (1, np.ones(())))
    )
