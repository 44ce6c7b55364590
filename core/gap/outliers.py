"""Visits that nothing in the library could explain: broken beams, wrong poses.

No visit is masked because the model under test fails there. Each is predicted from all others by geometry and the whole
library at once, every parameter within its prior; only what stands far from that prediction is set aside, and named.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.stats import chi2

from core.gap.world import World

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

CHANCE = 0.001  # of setting any good visit aside
MOST = 0.08  # share of visits above which it is structure, not outliers
PASSES = 12
POSE = 6  # numbers of a pose; visits with more show markers
WORST = 0.3
UNSEEN = 1e-6
SUPPLE = 0.4  # library parameters per measured scalar above which the library can explain anything
WILD = 2.0  # times the squared limit, when geometry alone predicts


def outliers(world: World) -> Bools:
    """Visits (V,) to set aside. Leave-one-out residual against geometry and library, studentised, robust scale.

    Where the library has more parameters than the data could fix it explains anything, a wild reading too. Then the
    geometry alone predicts, and a visit must stand so far out of the scatter as no smooth effect ever does.
    """
    setting = world.setting
    size = setting.whitener.shape[-1]
    y, whole = world.within_priors()
    G = whole[:, : world.G.shape[1]]
    # Errors of the model move all markers of a tool alike: as many numbers, but no more independent ones than a point has.
    alike = size // 3 if size > POSE and not setting.noise.absolute else 1
    limit = alike * float(chi2.isf(CHANCE / len(setting.used), size / alike))
    found = _far(whole, y, setting.used, limit, alike)
    if whole.shape[1] > SUPPLE * setting.used.sum() * size:
        found |= _far(G, y, setting.used, WILD * limit, alike)
    return found


def _far(X: Floats, y: Floats, used: Bools, limit: float, alike: int) -> Bools:
    """Visits beyond the limit, worst first; none when they are too many to be anything but structure."""
    kept = used.copy()
    size = len(y) // len(used)
    for _ in range(PASSES):
        distance = _left_out(X, y, np.repeat(kept, size), size)
        scale = max(1.0, float(np.median(distance[kept])) / (alike * float(chi2.median(size / alike))))
        far = kept & (distance / scale > limit)
        if not far.any():
            break
        # One wild visit bends the fit and makes good ones look far.
        kept &= ~(far & (distance > WORST * distance[kept].max()))
    found = used & ~kept
    return found if found.sum() <= max(2, MOST * used.sum()) else np.zeros_like(found)


def _left_out(X: Floats, y: Floats, kept: Bools, size: int) -> Floats:
    """Squared studentised leave-one-out distance (V,) of every visit, from the fit to the rows kept."""
    K = X[kept]
    H = K.T @ K
    H[np.diag_indices_from(H)] += 1.0
    factor = scipy.linalg.cho_factor(H)
    e = y - X @ scipy.linalg.cho_solve(factor, K.T @ y[kept])
    half = scipy.linalg.solve_triangular(factor[0], X.T, lower=factor[1], trans=0 if factor[1] else 1).T
    blocks = half.reshape(-1, size, X.shape[1])
    hat = np.matmul(blocks, blocks.transpose(0, 2, 1))
    inside = kept.reshape(-1, size)[:, 0]
    spread = np.where(inside[:, None, None], np.eye(size) - hat, np.eye(size) + hat)
    # A visit that nothing else can predict has no residual of its own: its directions count as nothing.
    w, V = np.linalg.eigh(spread)
    z = np.einsum("vij,vi->vj", V, e.reshape(-1, size))
    return np.asarray(np.sum(np.where(w > UNSEEN, z**2 / np.maximum(w, UNSEEN), 0.0), axis=1))
