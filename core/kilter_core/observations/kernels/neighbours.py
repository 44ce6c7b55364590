"""Which points hang together, each within a small distance of the next."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(cache=True)
def label_components(points: Floats, along: Floats, near: float, window: float) -> Ints:
    """Number (N,) of the component of each point (N, n): neighbours are within ``near`` in every coordinate.

    ``along (N,)`` ascends, and neighbours differ in it by no more than ``window``.
    """
    count, width = points.shape
    parent = np.arange(count)
    for i in range(count):
        for j in range(i + 1, count):
            if along[j] - along[i] > window:
                break
            close = True
            for k in range(width):
                if abs(points[i, k] - points[j, k]) > near:
                    close = False
                    break
            if close:
                a, b = _root(parent, i), _root(parent, j)
                parent[max(a, b)] = min(a, b)
    out = np.empty(count, dtype=np.int64)
    number = 0
    for i in range(count):
        if parent[i] == i:
            out[i] = number
            number += 1
        else:
            out[i] = out[_root(parent, i)]
    return out


@njit(cache=True)
def _root(parent: Ints, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i
