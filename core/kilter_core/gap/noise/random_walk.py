"""A drift without any course: what a random walk, shared by all visits, takes of their repeats.

Steady courses and waves that pass a test leave the finer half of a walk, and it was called noise: 20 to 28 µm where 17 was
right. Once a drift is certain, what is left of it is smoothed by as much as the repeats themselves ask for (restricted
maximum likelihood).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar

from kilter_core.observations.groups import subtract_group_means
from kilter_core.types import Bools, Floats, Ints

WAVES = 40  # of a walk: all but 1/200 of its variance
SHIFTS = 3  # of the motions, which come first
WAVES_OF_LARGE = 15
LARGE = 1500  # visits from which fewer waves are taken
RATIOS = np.geomspace(1e-3, 1e6, 46)  # variance of the walk over that of the noise, tried to begin with
SEEN = 1e-10


def fit_random_walk(
    away: Floats, motion: Floats, t: Floats, condition: Ints, kept: Bools, course: Floats
) -> tuple[Floats, float]:
    """The way (V, m) of all visits by a walk, and how many scalars of the repeats it takes.

    It goes along the first ``m`` or along all of the motions ``motion (V, m, k)``, whichever is likelier, beside the steady
    ``course (V, m, c)`` that was found. ``away (V, m)`` are residuals less the mean of their condition; ``kept (V,)`` marks
    the repeats that are not spikes.
    """
    size = away.shape[1]
    scalars = float(size * (kept.sum() - len(np.unique(condition[kept]))))
    F = subtract_group_means(course, condition, kept)[kept].reshape(-1, course.shape[2])
    Q, size_of, turn = np.linalg.svd(F, full_matrices=False)
    seen = size_of > np.sqrt(SEEN) * max(float(size_of[0]), np.finfo(float).tiny)
    Q, back = Q[:, seen], turn[seen].T / size_of[seen]
    y = subtract_group_means(away, condition, kept)[kept].reshape(-1)
    y = y - Q @ (Q.T @ y)
    tried = []
    for count in {min(SHIFTS, motion.shape[2]), motion.shape[2]}:
        X = _columns(motion[:, :, :count], t)
        Xc = subtract_group_means(X, condition, kept)[kept].reshape(-1, X.shape[2])
        along = Q.T @ Xc
        cost, amount, taken = _fit_wave_amplitudes(Xc - Q @ along, y, scalars - Q.shape[1])
        # What of the walk looks like the steady course went with that already.
        tried.append((cost, X @ amount - course @ (back @ (along @ amount)), taken))
    _, way, taken = min(tried, key=lambda one: one[0])
    return way, taken


def _fit_wave_amplitudes(X: Floats, y: Floats, scalars: float) -> tuple[float, Floats, float]:
    """Likelihood (less is likelier) of waves X (R, w), what they are likeliest to amount to, and how many scalars they take."""
    w, V = np.linalg.eigh(X.T @ X)
    able = w > SEEN * max(float(w[-1]), np.finfo(float).tiny)
    w, V = w[able], V[:, able]
    z = (V.T @ (X.T @ y)) / np.sqrt(w)
    cost, ratio = _likeliest(z**2, w, max(float(y @ y - z @ z), 0.0), scalars)
    return cost, V @ (z * ratio * np.sqrt(w) / (1.0 + ratio * w)), float(np.sum(ratio * w / (1.0 + ratio * w)))


def _columns(motion: Floats, t: Floats) -> Floats:
    """Motions along the waves of a walk (V, m, k K), each as large as its share of the walk."""
    u = (t - t.min()) / max(float(np.ptp(t)), np.finfo(float).tiny)
    k = np.arange(1, (WAVES_OF_LARGE if len(t) > LARGE else WAVES) + 1) - 0.5
    wave = np.sqrt(2.0) * np.sin(np.pi * np.outer(u, k)) / (np.pi * k)
    return np.asarray((motion[:, :, :, None] * wave[:, None, None, :]).reshape(*motion.shape[:2], -1))


def _likeliest(z2: Floats, w: Floats, rest: float, scalars: float) -> tuple[float, float]:
    """Restricted likelihood (less is likelier), and the variance of the walk over that of the noise; 0 for no walk."""

    def cost(ratio: float) -> float:
        grown = 1.0 + ratio * w
        noise = max((float(np.sum(z2 / grown)) + rest) / scalars, np.finfo(float).tiny)
        return 0.5 * float(scalars * np.log(noise) + np.sum(np.log(grown)))

    costs = [cost(r) for r in RATIOS]
    best = int(np.argmin(costs))
    if cost(0.0) <= costs[best]:
        return cost(0.0), 0.0
    low, high = (np.log(RATIOS[max(best - 1, 0)]), np.log(RATIOS[min(best + 1, len(RATIOS) - 1)]))
    found = minimize_scalar(lambda x: cost(float(np.exp(x))), bounds=(low, high), method="bounded")
    return float(found.fun), float(np.exp(found.x))
