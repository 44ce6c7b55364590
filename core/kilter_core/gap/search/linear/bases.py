"""Bases of columns: what of them the data see at all."""

from __future__ import annotations

import numpy as np

from kilter_core.gap.search.linear.gram import VISIBLE
from kilter_core.types import Floats

FIRM = 30.0  # data sigmas that one prior sigma of a geometric direction moves, from which its prior adds nothing to the data
UNFELT = 1e-3  # the same, below which nothing shows it


def split_geometry_directions(scaled: Floats) -> tuple[Floats, Floats]:
    """Directions (P, f) of geometry, columns ``scaled (R, P)`` by prior sigmas, that the data know by themselves, and those
    (P, w) that their priors know as well, whatever else is fitted: freed of them, they would follow an effect that nearly
    imitates them to many prior sigmas.
    """
    if scaled.shape[1] == 0 or len(scaled) == 0:
        return np.zeros((scaled.shape[1], 0)), np.zeros((scaled.shape[1], 0))
    _, s, vt = np.linalg.svd(np.linalg.qr(scaled, mode="r"))
    size = np.zeros(len(vt))
    size[: len(s)] = s
    firm = size > max(FIRM, 1e-10 * float(s[0]))
    return vt[firm].T, vt[~firm & (size > UNFELT)].T


def orthonormal(W: Floats) -> Floats:
    """Orthonormal basis of columns (R, Q)."""
    u, s, _ = np.linalg.svd(W, full_matrices=False)
    return np.asarray(u[:, s > np.sqrt(VISIBLE)])


def lengths(W: Floats) -> Floats:
    """Norms (Q,) of columns, without a copy of them squared."""
    return np.asarray(np.sqrt(np.einsum("rq,rq->q", W, W)))
