"""How the scatter of poses differs from pose to pose: joints come to rest a little off, and far poses show more of it.

A joint that settles with the same scatter everywhere moves the tool by its lever, which is what its compliance does too:
taken as the same scatter at every pose it would leave compliances far too sure.
"""

from __future__ import annotations

import numpy as np

from kilter_core.identify.fit.least_squares import Fit
from kilter_core.types import Bools, Floats

ROUNDS = 10  # of scoring, each half a step
LEAST = 0.003  # share of what is the same at every pose: without any, poses would be taken as exact across their levers
POSES_PER_SHARE = 4  # poses for each share that is estimated


def levers(fit: Fit) -> Floats:
    """What a rotation of each joint moves of every row (N, R, n), whitened as the residuals are."""
    problem = fit.problem
    prediction, J = problem.model.joint_jacobian(problem.batch, fit.values, problem.measurement.reads_joints)
    moved = problem.measurement.residual(prediction, J)
    parts = [problem.over_sigma_slope(block).reshape(len(J), -1, J.shape[2]) for block in moved.blocks]
    whole = np.concatenate(parts, axis=1)
    return whole if problem.weights.rows is None else whole * np.sqrt(problem.weights.rows)[:, None, None]


def scatter_of_poses(mean: Floats, lever: Floats, common: Floats, known: Floats, seen: Bools | None = None) -> Floats:
    """Covariance (G, R, R) of what the rows of each pose share, by scoring of variance components.

    ``mean (G, R)`` are the residuals of the poses, ``lever (G, R, n)`` what the joints move there. A share of ``common
    (R, R)``, the same at every pose, and of each joint's settling adds to what is ``known (G, R, R)`` of the rows' own.
    Numbers that a pose lacks, by ``seen (G, R)``, take no part there: zeros would say that it scatters less.
    """
    G, R, n = lever.shape
    flat = np.broadcast_to(common, (G, *common.shape))
    if seen is not None:
        flat = flat * (seen[:, :, None] & seen[:, None, :])
        known = np.where(seen[:, :, None] & seen[:, None, :], known, np.eye(R))
    if POSES_PER_SHARE * (n + 1) > G or np.linalg.eigvalsh(common)[0] <= 0.0:
        return flat
    size = np.einsum("gij,gij->j", lever, lever) / np.trace(common) / G
    scaled = lever / np.sqrt(np.where(size > 0.0, size, np.inf))  # a joint that moves nothing has no share
    share = np.concatenate([[1.0], np.zeros(n)])
    for _ in range(ROUNDS):
        inverse = np.asarray(np.linalg.inv(_together(share, flat, scaled) + known), dtype=np.float64)
        share = 0.5 * (share + _estimate_scatter_shares(inverse, mean, scaled, flat))
        share[0] = max(share[0], LEAST)
    return _together(share, flat, scaled)


def _together(share: Floats, flat: Floats, scaled: Floats) -> Floats:
    return np.asarray(share[0] * flat + (scaled * share[1:]) @ scaled.transpose(0, 2, 1))


def _estimate_scatter_shares(inverse: Floats, mean: Floats, scaled: Floats, flat: Floats) -> Floats:
    """Shares (1 + n,), none negative, that the residuals of the poses ask for under these inverse covariances."""
    n = scaled.shape[2]
    scaled_inverse = inverse @ scaled
    through = inverse @ flat
    M = np.empty((n + 1, n + 1))
    M[0, 0] = np.einsum("gij,gji->", through, through)
    M[0, 1:] = M[1:, 0] = np.einsum("gij,gij->j", scaled_inverse, flat @ scaled_inverse)
    M[1:, 1:] = np.sum((scaled.transpose(0, 2, 1) @ scaled_inverse) ** 2, axis=0)
    weighed = np.einsum("gij,gj->gi", inverse, mean)
    v = np.concatenate(
        [
            [np.einsum("gi,gij,gj->", weighed, flat, weighed)],
            np.sum(np.einsum("gij,gi->gj", scaled, weighed) ** 2, axis=0),
        ]
    )
    root = np.linalg.cholesky(M + 1e-9 * np.trace(M) * np.eye(n + 1))
    from scipy.optimize import nnls  # who only asks what a fit left does not compute it

    return np.asarray(nnls(root.T, np.linalg.solve(root, v))[0])
