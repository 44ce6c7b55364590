"""Visits that nothing in the library could explain: interrupted laser beams, wrong poses.

No visit is masked because the model under test fails there. Each is predicted from all others by geometry and the whole
library at once, every parameter within its prior; only what is far from that prediction is set aside, and named. The
prediction is a redescending fit: it is not bent by those it lets go of, even if they are a third of all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg
from scipy.linalg.blas import dtrmm
from scipy.linalg.lapack import dtrtri
from scipy.stats import chi2, f

from kilter_core.gap.search.linear.gram import Stacked
from kilter_core.gap.search.linear.linearized import LinearizedProblem, Tick, ignore_step
from kilter_core.gap.search.linear.settings import ProblemSettings
from kilter_core.gap.search.rows.wrong_rows import find_wrong
from kilter_core.identify.fit.robust import bulk_scale, descend_to_tukey_weights, median_scale
from kilter_core.types import Bools, Floats

CHANCE = 0.001  # of setting any good visit aside
POSE = 6  # numbers of a pose; visits with more show markers
UNSEEN = 1e-6
TOO_SMALL = 0.001  # chance of a bulk so far below the noise of the repeats, from which the repeats hold wrong readings
SUPPLE = 0.4  # library parameters per measured scalar above which the library can explain anything
WILD = 2.0  # times the squared limit, when geometry and what was named predict alone
ALIKE = 3  # fits in a row that let go of the same visits, after which the descent ends: its weights go on for dozens
LARGE = 3000  # visits from which the descent is made only where the plain fit leaves any visit far


def outliers(problem: LinearizedProblem, chosen: Sequence[int] = (), tick: Tick = ignore_step) -> Bools:
    """Visits (V,) to set aside. Leave-one-out residual against geometry and library, studentised, robust scale.

    Where the library has more parameters than the data could fix it explains anything, a wild reading too. Then geometry
    and the ``chosen`` columns alone predict, and a visit must be further outside the scatter than any smooth
    effect. ``tick`` is called before every fit, and may raise.
    """
    settings = problem.settings
    size = settings.whitener.shape[-1]
    y, whole = problem.within_priors()
    geometry = problem.G.shape[1]
    limit, alike = _limit(settings)
    supple = whole.width > SUPPLE * settings.used.sum() * size
    found = _find_outlying_visits(problem, whole, y, (limit, alike), supple, tick)
    if supple:
        known = [*range(geometry), *(geometry + k for k in chosen)]
        found |= _find_outlying_visits(problem, whole.only(known), y, (np.sqrt(WILD) * limit, alike), False, tick)
    return found


def stands_out(settings: ProblemSettings, values: Floats) -> bool:
    """Whether any visit is so far from the model at these values that it is worth asking what else could explain it."""
    limit, alike = _limit(settings)
    size = np.sqrt(np.sum(settings.whitened_residuals(values) ** 2, axis=1) / alike)
    return bool(size.max(initial=0.0) > limit)


def _limit(settings: ProblemSettings) -> tuple[float, int]:
    """Size beyond which chance puts hardly any visit, and how many numbers of a visit move together."""
    size = settings.whitener.shape[-1]
    # Errors of the model move all markers of a tool together: as many numbers, but no more independent ones than a point has.
    of_tool = settings.source.tool_numbers
    alike = of_tool // 3 if of_tool > POSE and not settings.noise.absolute else 1
    return float(np.sqrt(chi2.isf(CHANCE / len(settings.used), size / alike))), alike


def _find_outlying_visits(
    problem: LinearizedProblem, X: Stacked, y: Floats, limit_alike: tuple[float, int], supple: bool, tick: Tick
) -> Bools:
    """Visits beyond the limit, if they are wrong readings and no structure. What ``supple`` columns leave refutes no noise."""
    used, (limit, alike) = problem.settings.used, limit_alike
    dimension, X = max(1, round(X.size / alike)), X.condense_columns()

    def sizes(weight: Floats) -> Floats:
        tick()
        every = np.zeros(len(used))
        every[used] = weight
        return np.sqrt(_left_out(X, y, every)[used] / alike)

    start = sizes(np.ones(int(used.sum())))
    far = np.zeros(len(used), dtype=bool)
    if len(used) > LARGE and float(start.max(initial=0.0)) < limit:
        return far

    def beyond(size: Floats, scale: float) -> Bools:
        # A noise that comes from the fit, or is refuted, holds the wrong readings themselves: the bulk says better what it is.
        refuted = not supple and _is_noise_too_large(problem.settings, scale)
        least = 1.0 if problem.settings.trusted and not refuted else 0.0
        return np.asarray(size > limit * max(least, scale))

    known: list[bytes] = []

    def is_selection_stable(size: Floats) -> bool:
        known.append(beyond(size, bulk_scale(size, dimension, median_scale(size, dimension))).tobytes())
        return len(set(known[-ALIKE:])) == 1 and len(known) >= ALIKE

    robust = descend_to_tukey_weights(sizes, start, dimension, is_selection_stable)
    far[used] = beyond(robust.size, robust.scale)
    whole = np.zeros(len(used))
    whole[used] = robust.size
    if not far.any():
        return far
    every = np.zeros(len(used))
    every[used] = robust.weight
    return find_wrong(problem, far, whole, _weighted_fit_residuals(X, y, every))


def _is_noise_too_large(settings: ProblemSettings, scale: float) -> bool:
    """Whether the bulk of the visits, of this scale in units of the noise, is too small for it: wrong readings among the
    repeats made it. A median knows its scale half as well as a mean square does, and the fit took some: each visit counts
    as one number.
    """
    noise = settings.noise
    if noise.repeats is None or not noise.freedom > 0.0:
        return False
    return bool(f.cdf(scale**2, float(settings.used.sum()), noise.freedom) <= TOO_SMALL)


def _left_out(X: Stacked, y: Floats, weight: Floats) -> Floats:
    """Squared studentised distance (V,) of every visit from the weighted fit to all others."""
    beta, upper = _fit(X, y, weight)
    out = np.empty(len(weight))
    for part, columns in X.each():
        visits = slice(part.start // X.size, part.stop // X.size)
        half = dtrmm(1.0, upper, columns.T, trans_a=1).T  # a triangle: half of a product, and faster than solving
        blocks = half.reshape(-1, X.size, X.width)
        w, V = np.linalg.eigh(np.matmul(blocks, blocks.transpose(0, 2, 1)))
        z = np.einsum("vij,vi->vj", V, (y[part] - columns @ beta).reshape(-1, X.size))
        # Without its own visit a direction is off by z / (1 - w h) and known to 1 + h / (1 - w h).
        free = 1.0 - weight[visits, None] * w
        spread = free * (free + w)
        # A visit that nothing else can predict has no residual of its own: its directions count as nothing.
        out[visits] = np.sum(np.where(free > UNSEEN, z**2 / np.maximum(spread, UNSEEN**2), 0.0), axis=1)
    return out


def _weighted_fit_residuals(X: Stacked, y: Floats, weight: Floats) -> Floats:
    """Error (V, m) of every visit against the weighted fit."""
    beta, _ = _fit(X, y, weight)
    return np.concatenate([y[part] - columns @ beta for part, columns in X.each()]).reshape(-1, X.size)


def _fit(X: Stacked, y: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Amounts (F,) of the weighted fit within the priors, and the inverse (F, F) of the upper triangle of its matrix."""
    H, b = np.eye(X.width), np.zeros(X.width)
    for part, columns in X.each():
        root = np.repeat(np.sqrt(weight[part.start // X.size : part.stop // X.size]), X.size)
        K = columns * root[:, None]
        H += K.T @ K
        b += K.T @ (y[part] * root)
    factor = scipy.linalg.cholesky(H)
    return scipy.linalg.cho_solve((factor, False), b), dtrtri(factor)[0]
