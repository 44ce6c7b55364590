"""After every name: what is noise, and which readings are wrong, judged anew by the model with what it knows by now.

Without repeats the noise is the scatter of the fit. Frozen at the first fit it holds the gap itself: wrong readings do not
stand out of it, and the next effect hides under the first (an arm of 0.02 mm was said to have 0.08). With repeats a name
that follows the clock or the temperature takes its share out of what they differ by, and what is left of them is the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kilter_core.gap.noise.from_repeats import FIT, Noise, noise_again, refitted
from kilter_core.gap.search.contrasts import fitted_away
from kilter_core.gap.search.outliers import LARGE, outliers, stands_out
from kilter_core.gap.search.source import ToolSource
from kilter_core.gap.search.world import Setting, World, refit, world_at
from kilter_core.types import Bools

CHANGED = 0.02  # of the noise, from which a fit is made anew
FREER = 0.1  # of its freedom, from which the same
ROUNDS = 3  # more of noise read from repeats and amounts fitted under it


def renewed(world: World, columns: Sequence[int]) -> World:
    """The world re-fitted with noise and outliers as the fit with these library columns shows them; itself if alike.

    Every visit is judged, also those set aside before: one may come back. A drift in a noise that came from repeats keeps
    the amount of the name that explains it near its prior: the noise that is left of them lets it go, in some rounds.
    """
    before, world = world, _renewed(world, columns)
    for _ in range(ROUNDS if world is not before and world.setting.noise.repeats is not None else 0):
        noise = _with_noise(world.setting, world, columns, world.setting.used).noise
        if _alike(world.setting.noise, noise):
            break
        world = refit(replace(world.setting, noise=noise), world.values, columns)
    return world


def _renewed(world: World, columns: Sequence[int]) -> World:
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
    if np.array_equal(used, setting.used) and _alike(setting.noise, after.noise):
        return world
    return refit(after, world.values, columns)


def under(setting: Setting, world: World, columns: Sequence[int] = ()) -> World:
    """A world re-fitted under the noise and outliers of another, so that the two can be compared."""
    return world if setting is world.setting else refit(setting, world.values, columns)


def _alike(before: Noise, after: Noise) -> bool:
    """Whether nothing changed that a verdict could rest on."""
    if before is after:
        return True
    ratio = after.coordinate / max(before.coordinate, 1e-300)
    freedom = after.freedom / before.freedom if before.freedom > 0.0 else 1.0
    return abs(ratio - 1.0) < CHANGED and abs(freedom - 1.0) < FREER and before.most == after.most


def _with_noise(setting: Setting, world: World, columns: Sequence[int], used: Bools) -> Setting:
    """The noise of the fit where it comes from there, that of repeats without what the fit explains; others stay."""
    if setting.noise.repeats is not None:
        return replace(setting, noise=_of_repeats(setting, world, columns, used))
    if setting.noise.source != FIT or setting.trusted:
        return setting
    residual = setting.source.residual(world.values)
    free = world.U.shape[1] + len(columns)
    noise = refitted(setting.noise, residual, used, min(0.9, free / max(used.sum() * residual.shape[1], 1)))
    return replace(setting, noise=noise.even() if isinstance(setting.source, ToolSource) else noise)


def _of_repeats(setting: Setting, world: World, columns: Sequence[int], used: Bools) -> Noise:
    """The noise of the repeats at this fit, with equal weights where it had them."""
    noise = setting.noise
    assert noise.repeats is not None
    taken = fitted_away(world, columns, noise.repeats.visits.condition)
    again = noise_again(noise, setting.source.residual(world.values), taken, used)
    if again is noise or not np.allclose(noise.visit, noise.even().visit, rtol=1e-9, atol=0.0):
        return again
    return again.even()
