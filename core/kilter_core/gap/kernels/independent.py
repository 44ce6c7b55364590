"""What sets of columns take of the data, and by how many independent directions: one rule for every part of a search.

A search looks at thousands of sets of some dozen columns: in numpy most of that time goes into calling it.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ROUNDING = 0.1  # of the least that is added to a square, below which only rounding brings what is left of it


@njit(cache=True)
def rooted(A: Floats, least: float, half: Floats) -> None:
    """Fill ``half (d, d)``, upper triangle, with a root of the inverse of inner products ``A (d, d)`` plus ``least``.

    ``half`` times its own transpose is that inverse.
    """
    d = len(A)
    U = A.copy()
    for k in range(d):
        U[k, k] += least
    for k in range(d):
        pivot = np.sqrt(max(U[k, k], least * ROUNDING))
        U[k, k] = pivot
        for j in range(k + 1, d):
            U[k, j] /= pivot
        for i in range(k + 1, d):
            v = U[k, i]
            for j in range(i, d):
                U[i, j] -= v * U[k, j]
    half[:] = 0.0
    for c in range(d):
        row = half[c]
        row[c] = 1.0
        for j in range(c, d):
            row[j] /= U[j, j]
            for i in range(j + 1, d):
                row[i] -= row[j] * U[j, i]


@njit(cache=True)
def scanned(
    whole: Floats, K: Floats, taken: Ints, columns: Ints, starts: Ints, least: float, halves: Floats, degrees: Floats
) -> None:
    """Every candidate given what is taken: a root of the inverse of its own block, and its independent directions.

    ``whole (Q, Q)`` less ``K (Q, t)`` times its rows ``taken (t,)`` are the inner products. The columns of candidate k are
    ``columns[starts[k] : starts[k + 1]]``; ``halves`` holds the roots (d, d) one after another.
    """
    place = 0
    for k in range(len(starts) - 1):
        index = columns[starts[k] : starts[k + 1]]
        d = len(index)
        A, half = np.empty((d, d)), np.empty((d, d))
        for i in range(d):
            for j in range(i + 1):
                v = whole[index[i], index[j]]
                for t in range(len(taken)):
                    v -= K[index[i], t] * whole[index[j], taken[t]]
                A[i, j] = v
                A[j, i] = v
        rooted(A, least, half)
        degrees[k] = d - least * _lost(half, K, index)
        for i in range(d):
            for j in range(d):
                halves[place + i * d + j] = half[i, j]
        place += d * d


@njit(cache=True)
def _lost(half: Floats, K: Floats, index: Ints) -> float:
    """By how much the trace of the inverse grows with a candidate: its own block's, and what it adds to the one taken."""
    d, total = len(index), 0.0
    for j in range(d):
        for i in range(j + 1):
            total += half[i, j] ** 2
        for t in range(K.shape[1]):
            along = 0.0
            for i in range(j + 1):
                along += half[i, j] * K[index[i], t]
            total += along**2
    return total


@njit(cache=True)
def taken_off(data: Floats, columns: Ints, starts: Ints, halves: Floats, out: Floats) -> None:
    """Chi-square (B, K) that every candidate takes of the data (B, Q): its own through the root of its inverse, squared."""
    for b in range(len(data)):
        place = 0
        for k in range(len(starts) - 1):
            d, total = starts[k + 1] - starts[k], 0.0
            for j in range(d):
                z = 0.0
                for i in range(j + 1):
                    z += data[b, columns[starts[k] + i]] * halves[place + i * d + j]
                total += z * z
            out[b, k] = total
            place += d * d
