"""What each candidate of a scan takes off chi-square: thousands of small matrices, of which a library call each is slow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kilter_core.arm.kernels.compiled import compiled

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

HIDDEN = 1e-14  # square of a unit column below which what is taken holds all of it
FAST = {"error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz", "arcp"}}


@compiled(**FAST)
def reductions(
    whole: Floats, c: Floats, K: Floats, along: Floats, wanted: Bools, starts: Ints, columns: Ints,
    visible: float, surely: float, S: Floats, d: Ints,
) -> None:  # fmt: skip
    """Write chi-square ``S (N,)`` that each wanted candidate takes, and in how many directions ``d (N,)``.

    The columns of candidate n are ``columns[starts[n]:starts[n + 1]]`` of ``whole (Q, Q)``, less ``K (Q, t)`` times
    ``along (Q, t)``. Directions with an eigenvalue up to ``visible`` count as none; they are looked for by eigenvalues only
    where the trace of the inverse is not below ``surely``, which no eigenvalue too small to count is.
    """
    widest = 1
    for n in range(len(starts) - 1):
        widest = max(widest, starts[n + 1] - starts[n])
    A, z, own = np.empty((widest, widest)), np.empty(widest), np.empty(widest, dtype=np.int64)
    for n in range(len(starts) - 1):
        if not wanted[n]:
            continue
        size = 0
        for k in range(starts[n], starts[n + 1]):
            square = _product(whole, K, along, columns[k], columns[k])
            if square > HIDDEN:
                own[size], A[size, size] = columns[k], square
                size += 1
        if size == 0:
            S[n], d[n] = 0.0, 0
        elif size == 1:
            seen = A[0, 0] > visible
            S[n], d[n] = (c[own[0]] ** 2 / A[0, 0] if seen else 0.0), (1 if seen else 0)
        elif _factored(whole, c, K, along, own[:size], A, z) and _trace(A, size) < surely:
            d[n], S[n] = size, 0.0
            for a in range(size):
                S[n] += z[a] * z[a]
        else:
            S[n], d[n] = _by_eigenvalues(whole, c, K, along, columns[starts[n] : starts[n + 1]], visible)


@compiled(**FAST)
def _product(whole: Floats, K: Floats, along: Floats, i: int, j: int) -> float:
    value = whole[i, j]
    for t in range(K.shape[1]):
        value -= K[i, t] * along[j, t]
    return value


@compiled(**FAST)
def _factored(whole: Floats, c: Floats, K: Floats, along: Floats, own: Ints, A: Floats, z: Floats) -> bool:
    """Write the triangle of the block of ``own (d,)`` columns, whose diagonal ``A`` holds, and the data ``z`` under it."""
    for a in range(len(own)):
        left, right = A[a, a], c[own[a]]
        for b in range(a):
            value = _product(whole, K, along, own[a], own[b])
            for m in range(b):
                value -= A[a, m] * A[b, m]
            A[a, b] = value / A[b, b]
            left -= A[a, b] * A[a, b]
            right -= A[a, b] * z[b]
        if not left > 0.0:
            return False
        A[a, a] = np.sqrt(left)
        z[a] = right / A[a, a]
    return True


@compiled(**FAST)
def _trace(A: Floats, size: int) -> float:
    """Trace of the inverse of a matrix by its triangle."""
    total, column = 0.0, np.empty(size)
    for b in range(size):
        for a in range(b, size):
            value = 1.0 if a == b else 0.0
            for m in range(b, a):
                value -= A[a, m] * column[m]
            column[a] = value / A[a, a]
            total += column[a] * column[a]
    return total


@compiled(**FAST)
def _by_eigenvalues(whole: Floats, c: Floats, K: Floats, along: Floats, own: Ints, visible: float) -> tuple[float, int]:
    block = np.empty((len(own), len(own)))
    for a in range(len(own)):
        for b in range(a + 1):
            block[a, b] = block[b, a] = _product(whole, K, along, own[a], own[b])
    w, V = np.linalg.eigh(block)
    total, count = 0.0, 0
    for m in range(len(own)):
        if w[m] > visible:
            part = 0.0
            for a in range(len(own)):
                part += V[a, m] * c[own[a]]
            total += part * part / w[m]
            count += 1
    return total, count
