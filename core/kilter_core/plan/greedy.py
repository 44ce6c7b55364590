"""Greedy choice of the poses that maximise the determinant of the information."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kilter_core.types import Floats, Ints


def most_informative(
    X: Floats, count: int, progress: Callable[[float], None] | None = None, known: Floats | None = None
) -> Ints:
    """Pick (count,) of N poses by their whitened derivatives ``X (N, r, P)``, parameters in units of their priors.

    ``known (P, P)`` is the covariance of these priors in such units, the identity when None.
    """
    C = np.eye(X.shape[2]) if known is None else known
    picked: list[int] = []
    for k in range(count):
        XC = X @ C
        S = np.eye(X.shape[1]) + XC @ X.transpose(0, 2, 1)
        gain = np.linalg.slogdet(S)[1]
        gain[picked] = -np.inf
        best = int(np.argmax(gain))
        picked.append(best)
        C = C - XC[best].T @ np.linalg.solve(S[best], XC[best])
        if progress is not None:
            progress((k + 1) / count)
    return np.array(picked)
