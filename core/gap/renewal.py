"""After every name: what is noise, and which readings are wrong, judged anew by the model with what it knows by now.

Without repeats the noise is the scatter of the fit. Frozen at the first fit it holds the gap itself: wrong readings do not
stand out of it, and the next effect hides under the first (an arm of 0.02 mm was said to have 0.08).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from core.gap.noise import FIT, refitted
from core.gap.outliers import LARGE, outliers, stands_out
from core.gap.source import ToolSource
from core.gap.world import Setting, World, refit, world_at

Floats = NDArray[np.float64]

CHANGED = 0.02  # of the noise, from which a fit is made anew


def renewed(world: World, columns: Sequence[int]) -> World:
    """The world re-fitted with noise and outliers as the fit with these library columns shows them; itself if alike.

    Every visit is judged, also those set aside before: one may come back.
    """
    setting = world.setting
    if setting.inflation > 1.0:  # rows alike in time: a disturbance cannot be told from what they have in common
        return world
    every = replace(setting, used=np.ones(len(setting.used), dtype=bool))
    every = _with_noise(every, world, columns, setting.used)
    if len(setting.used) > LARGE and setting.used.all() and not stands_out(every, world.values):
        used = setting.used
    else:
        used = ~outliers(world_at(every, world.values), columns)
    after = _with_noise(replace(every, used=used), world, columns, used)
    ratio = after.noise.coordinate / max(setting.noise.coordinate, 1e-300)
    if np.array_equal(used, setting.used) and abs(ratio - 1.0) < CHANGED:
        return world
    return refit(after, world.values, columns)


def under(setting: Setting, world: World, columns: Sequence[int] = ()) -> World:
    """A world re-fitted under the noise and outliers of another, so that the two can be compared."""
    return world if setting is world.setting else refit(setting, world.values, columns)


def _with_noise(setting: Setting, world: World, columns: Sequence[int], used: NDArray[np.bool_]) -> Setting:
    """The noise of the fit where it comes from there; that of repeats and of correlated rows stays."""
    if setting.noise.source != FIT or setting.trusted:
        return setting
    residual = setting.source.residual(world.values)
    fitted = world.U.shape[1] + len(columns)
    noise = refitted(setting.noise, residual, used, min(0.9, fitted / max(used.sum() * residual.shape[1], 1)))
    return replace(setting, noise=noise.even() if isinstance(setting.source, ToolSource) else noise)
