"""A laser tracker: noise that grows with range and lies across the beam, scatter of each approach, wrong readings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.options import Options

Floats = NDArray[np.float64]
CLUSTER_M = 0.5e-3  # how far wrong readings of a cluster are, all to one side
WHOLE_VISIT_SHARE = 0.3  # of the outliers: the arm was somewhere else; the others are single broken readings


def reading_covariance(p: Floats, options: Options) -> Floats:
    """Covariance (V, 3, 3) m2 of one reading at ``p (V, 3)`` m from the tracker at the origin."""
    reach = np.linalg.norm(p, axis=1)
    along = np.einsum("vi,vj->vij", p, p) / reach[:, None, None] ** 2
    far = (options.range_um + options.range_um_per_m * reach) * 1e-6
    wide = options.angle_urad * 1e-6 * reach
    return np.asarray(far[:, None, None] ** 2 * along + wide[:, None, None] ** 2 * (np.eye(3) - along))


def visit_covariance(p: Floats, options: Options) -> Floats:
    """Covariance (V, 3, 3) m2 of the mean of a visit's readings: approach scatter and the readings' share."""
    scatter = (options.approach_um * 1e-6) ** 2 * np.eye(3)
    return np.asarray(scatter + reading_covariance(p, options) / options.repeats)


def read(
    p: Floats, options: Options, rng: np.random.Generator, approach: NDArray[np.int64] | None = None
) -> tuple[Floats, NDArray[np.bool_]]:
    """Readings (V, repeats, 3) m of the true points ``p (V, 3)`` and which of them are outliers (V, repeats).

    Visits of one number in ``approach (V,)`` were not left in between: they share where the arm came to rest.
    """
    shape = (len(p), options.repeats, 3)
    roots = np.linalg.cholesky(reading_covariance(p, options))
    noise = np.einsum("vij,vrj->vri", roots, rng.normal(size=shape))
    settled = rng.normal(0.0, options.approach_um * 1e-6, (len(p), 1, 3))
    if approach is not None:
        settled = settled[np.unique(approach, return_inverse=True)[1].reshape(-1)]
    whole = rng.uniform(size=(len(p), 1)) < options.outliers * WHOLE_VISIT_SHARE
    single = rng.uniform(size=shape[:2]) < options.outliers * (1.0 - WHOLE_VISIT_SHARE)
    jumps = rng.normal(size=shape)
    jumps[whole[:, 0]] = jumps[whole[:, 0], :1]
    jumps *= rng.uniform(0.2e-3, 2e-3, (len(p), 1, 1)) / np.linalg.norm(jumps, axis=2, keepdims=True)
    wrong = whole | single
    p = p[:, None, :] + settled + noise + np.where(wrong[:, :, None], jumps, 0.0)
    if options.clustered:
        p, wrong = _clustered(p, wrong, options, rng)
    return p, wrong


def _clustered(
    p: Floats, wrong: NDArray[np.bool_], options: Options, rng: np.random.Generator
) -> tuple[Floats, NDArray[np.bool_]]:
    """Whole visits wrong alike: a reflector that sat badly for a while, seen from one side."""
    hit = np.zeros(len(p), dtype=bool)
    hit[rng.permutation(len(p))[: round(options.clustered * len(p))]] = True
    side = rng.normal(size=3)
    jump = CLUSTER_M * side / np.linalg.norm(side) + rng.normal(0.0, 0.05 * CLUSTER_M, (len(p), 3))
    return p + np.where(hit[:, None], jump, 0.0)[:, None, :], wrong | hit[:, None]
