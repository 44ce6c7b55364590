"""Would other data of the same kind give the same names: the whole selection repeated on resampled residuals."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from core.gap.hunt import Hunt
from core.gap.scan import ALMOST_ALL, FEWEST_FLIPS, residual_given, summed

Floats = NDArray[np.float64]


def inclusion(
    hunt: Hunt, classes: dict[int, tuple[int, ...]], draws: int, seed: int, tell: Callable[[float], None]
) -> dict[int, tuple[float, float]]:
    """Share of resamples in which each chosen candidate, and any of its class, is selected again.

    A wild bootstrap: the fitted effects plus the residuals of whole poses with random signs; with too few poses, plus
    Gaussian noise. ``classes`` gives the places that count as the same name.
    """
    world, selector = hunt.world, hunt.selector
    if not hunt.chosen:
        return {}
    rng = np.random.default_rng(seed)
    own = dict.fromkeys(hunt.chosen, 0)
    any_ = dict.fromkeys(hunt.chosen, 0)
    data, chi2 = _resampled(hunt, draws, rng)
    most = len(hunt.chosen) + 2
    for b in range(draws):
        if b % 5 == 0:
            tell(b / draws)
        again = selector.searched(world.gram.with_data(data[b], float(chi2[b])), hunt.critical, most)
        names = {(selector.scorer.candidates[k].id, selector.scorer.candidates[k].joints) for k in again}
        columns = set(selector.columns(again))
        for k in hunt.chosen:
            found = _found(hunt, k, names, columns)
            own[k] += found
            any_[k] += found or any(_found(hunt, m, names, columns) for m in classes.get(k, ()))
    return {k: (own[k] / draws, any_[k] / draws) for k in hunt.chosen}


def _found(hunt: Hunt, place: int, names: set[tuple[str, tuple[int, ...] | None]], columns: set[int]) -> bool:
    """Whether a candidate was selected: by name, or most of its columns within a family or as members of one."""
    candidate = hunt.selector.scorer.candidates[place]
    if (candidate.id, candidate.joints) in names:
        return True
    same = {name for name, _ in names}
    return candidate.id in same and len(columns & set(candidate.columns)) >= 0.5 * len(candidate.columns)


def _resampled(hunt: Hunt, draws: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    world = hunt.world
    columns = hunt.columns
    beta = world.gram.solve(columns)
    signal = world.A[:, columns] @ beta
    power = float(beta @ world.A[np.ix_(columns, columns)] @ beta)
    group = world.setting.group
    poses = int(group.max()) + 1
    if poses < FEWEST_FLIPS:
        w, V = np.linalg.eigh(world.A)
        z = rng.standard_normal((draws, len(w)))
        noise = (z * np.sqrt(np.maximum(w, 0.0))) @ V.T
        chi2 = rng.chisquare(max(world.nu, 1.0), draws)
    else:
        basis = world.basis(columns)
        r = residual_given(world, columns) / np.sqrt(1.0 - np.minimum(np.sum(basis**2, axis=1), ALMOST_ALL))
        flips = rng.choice([-1.0, 1.0], size=(draws, poses))
        rows = group[world.row_visit]
        noise = flips @ summed(world.W * r[:, None], rows, poses)
        chi2 = float(r @ r) - np.sum((flips @ summed(world.U * r[:, None], rows, poses)) ** 2, axis=1)
    return signal + noise, power + 2.0 * noise[:, columns] @ beta + np.maximum(chi2, 0.0)
