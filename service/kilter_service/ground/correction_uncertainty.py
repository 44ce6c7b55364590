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
    from kilter_core.observations import Observations


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
    out = np.full((len(done.wanted), 3), np.nan)
    good = done.status == Status.OK
    if known is None or not good.any():
        return out
    arm, there = _as_corrected(calibration, done, temperature_c)
    out[good] = known.of_the_tool(arm, there.select(good), arm.nominal_in_wanted_frames().model.T_base[:3, :3])
    return out


def from_unknown_sides(
    calibration: Calibration, done: CorrectedTrajectory, temperature_c: float | None = None
) -> Floats:
    """Largest displacements (N, 3) m by joints whose last motion nobody knows, along the axes of the wanted base.

    Half of what the tool moves between the two sides of each such joint's backlash. 0 where all directions are known.
    """
    out = np.zeros((len(done.wanted), 3))
    arm, there = _as_corrected(calibration, done, temperature_c)
    if "direction" not in arm.model.needs:
        return out
    # What follows a column that a path lacks moves the tool alike on either side.
    arm = arm.with_effects(
        [e for e in arm.model.effects if all(getattr(there, name, 0) is not None for name in e.needs)]
    )
    axes = arm.nominal_in_wanted_frames().model.T_base[:3, :3]
    unknown = (done.direction == 0.0) & (done.status == Status.OK)[:, None]
    for joint in np.flatnonzero(unknown.any(axis=0)):
        rows = there.select(unknown[:, joint])
        assert rows.direction is not None
        sides = []
        for side in (-1.0, 1.0):
            direction = rows.direction.copy()
            direction[:, joint] = side
            sides.append(arm.predict(replace(rows, direction=direction)).position)
        out[unknown[:, joint]] += 0.5 * np.abs((sides[1] - sides[0]) @ axes)
    return out


def _as_corrected(
    calibration: Calibration, done: CorrectedTrajectory, temperature_c: float | None
) -> tuple[Calibration, Observations]:
    """The arm with the effects that are corrected, and the rows (N,) it was sent to."""
    rows = done.wanted
    there = replace(rows, q=done.q, direction=done.direction)
    if rows.temperature_c is None and temperature_c is not None:
        there = replace(there, temperature_c=np.full(len(rows), temperature_c))
    corrected = [e for key, e in zip(calibration.model.effect_slices(), calibration.model.effects, strict=True)
                 if key not in done.not_corrected]  # fmt: skip
    return calibration.with_effects(corrected), there


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
