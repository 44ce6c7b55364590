"""Amounts of a candidate by a part of the data, as a judge of evidence asks for them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.types import Floats


def amounts(search: SearchResult, columns: Sequence[int], X: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Amounts (K,) of unit library ``columns`` within their priors, and their covariance (K, K).

    ``X (R, K)`` are their whitened derivatives in the data ``y (R,)`` asked, all else taken out of both.
    """
    problem, index = search.problem, list(columns)
    prior = np.maximum(problem.settings.source.library_sigma[index] * problem.size[index], 1e-300)
    variance = search.selector.variance(problem.gram, search.chosen)
    covariance = np.asarray(np.linalg.inv(X.T @ X / variance + np.diag(1.0 / prior**2)), dtype=np.float64)
    return covariance @ (X.T @ y) / variance, covariance
