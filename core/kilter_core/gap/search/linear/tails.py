"""Tail probabilities of chi-square over a noise variance that is known, or only estimated."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import fdtrc, gammaincc

from kilter_core.types import Floats


def tail(taken: ArrayLike, d: ArrayLike, freedom: ArrayLike = np.inf) -> Floats:
    """Chance of chi-square ``taken`` of ``d`` directions over a variance that rests on ``freedom`` numbers.

    F where those are finite: a variance from thirty numbers is off by a quarter, and a chi-square tail would call what
    that makes large certain.
    """
    size = np.maximum(np.asarray(taken, dtype=np.float64), 0.0)
    known, count = np.asarray(freedom, dtype=np.float64), np.maximum(np.asarray(d, dtype=np.float64), 1.0)
    finite = np.isfinite(known)
    if not finite.any():  # a selection asks tens of thousands of times, of a noise of one kind
        return np.asarray(gammaincc(count / 2.0, size / 2.0))
    if finite.all():
        return np.asarray(fdtrc(count, np.maximum(known, 1.0), size / count))
    estimated = fdtrc(count, np.where(finite, np.maximum(known, 1.0), 1.0), size / count)
    return np.where(finite, estimated, gammaincc(count / 2.0, size / 2.0))
