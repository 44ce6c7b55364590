"""What each candidate of a scan takes off chi-square: thousands of small matrices, of which a library call each is slow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kilter_core.arm.kernels.compiled import compile_kernel

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SURELY = 0.4  # of a direction that ridges may take off a whole number of them: less than half changes none
FAST = {"error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz", "arcp"}}


@compile_kernel(**FAST)
def reductions(
    whole: Floats,
    c: Floats,
    K: Floats,
    along: Floats,
    copies: Floats,
    free: Bools,
    wanted: Bools,
    starts: Ints,
    columns: Ints,
    ridge: float,
    S: Floats,
    d: Ints,
) -> None:
    """Write chi-square ``S (N,)`` that each wanted candidate takes, and in how many directions ``d (N,)``.

    The columns of candidate n are those of ``columns[starts[n]:starts[n + 1]]`` that are ``free (Q,)``, of ``whole (Q, Q)``
    less ``K (Q, k)`` times ``along (Q, k)``, with the ``ridge`` added to the square of each. Its directions are what they
    add to the trace of the fit, to which those that are taken, ``copies (Q, t)`` of them in each column, belong.
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
            if free[columns[k]]:
                own[size] = columns[k]
                size += 1
        S[n], d[n] = 0.0, 0
        if size > 0:
            _factorise_block(whole, c, K, along, ridge, own[:size], A, z)
            for a in range(size):
                S[n] += z[a] * z[a]
            far = 1.0
            for a in range(size):
                for t in range(copies.shape[1]):
                    far += copies[own[a], t] ** 2
            short = ridge * _trace(A, size)
            if short * far > SURELY:  # no more than that the copies can add
                short += ridge * _sum_squared_copies(A, copies, own[:size])
            d[n] = int(np.floor(size - short + 0.5))


@compile_kernel(**FAST)
def _product(whole: Floats, K: Floats, along: Floats, i: int, j: int) -> float:
    value = whole[i, j]
    for t in range(K.shape[1]):
        value -= K[i, t] * along[j, t]
    return value


@compile_kernel(**FAST)
def _factorise_block(
    whole: Floats, c: Floats, K: Floats, along: Floats, ridge: float, own: Ints, A: Floats, z: Floats
) -> None:
    """Write the triangle ``A`` of the block of ``own (d,)`` columns, and the data ``z`` under it.

    No column can leave less than its ridge; what rounding leaves less is that.
    """
    for a in range(len(own)):
        left, right = _product(whole, K, along, own[a], own[a]) + ridge, c[own[a]]
        for b in range(a):
            value = _product(whole, K, along, own[a], own[b])
            for m in range(b):
                value -= A[a, m] * A[b, m]
            A[a, b] = value / A[b, b]
            left -= A[a, b] * A[a, b]
            right -= A[a, b] * z[b]
        A[a, a] = np.sqrt(max(left, ridge))
        z[a] = right / A[a, a]


@compile_kernel(**FAST)
def _sum_squared_copies(A: Floats, copies: Floats, own: Ints) -> float:
    """Sum of the squares of the copies under the triangle of a block."""
    total, column = 0.0, np.empty(len(own))
    for t in range(copies.shape[1]):
        for a in range(len(own)):
            value = copies[own[a], t]
            for m in range(a):
                value -= A[a, m] * column[m]
            column[a] = value / A[a, a]
            total += column[a] * column[a]
    return total


@compile_kernel(**FAST)
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
