"""Bases of columns: what of them the data see at all."""

from __future__ import annotations

import numpy as np

from kilter_core.gap.search.linear.gram import VISIBLE
from kilter_core.types import Floats

SEEN = 0.5  # data sigmas that one prior sigma of a geometric direction moves; below, the prior knows it better than the data


def seen(scaled: Floats) -> Floats:
    """Orthonormal basis of the directions of geometry that the data see at all."""
    if scaled.shape[1] == 0 or len(scaled) == 0:
        return np.zeros((len(scaled), 0))
    Q, R = np.linalg.qr(scaled)
    u, s, _ = np.linalg.svd(R)
    return np.asarray(Q @ u[:, : len(s)][:, s > max(SEEN, 1e-10 * float(s[0]))])


def orthonormal(W: Floats) -> Floats:
    """Orthonormal basis of columns (R, Q)."""
    u, s, _ = np.linalg.svd(W, full_matrices=False)
    return np.asarray(u[:, s > np.sqrt(VISIBLE)])


def lengths(W: Floats) -> Floats:
    """Norms (Q,) of columns, without a copy of them squared."""
    return np.asarray(np.sqrt(np.einsum("rq,rq->q", W, W)))
