"""Sizes in space (m, rad) of what a search holds whitened: errors of the visits, noise, and what an effect moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.gap.search.linear.settings import ProblemSettings
from kilter_core.types import Floats


def fit_rms(problem: LinearizedProblem) -> float:
    """Rms error (m or rad) of the visits at the values of the fit itself: what a version that holds them leaves."""
    return _rms_in_space(problem.settings, problem.raw)


def rms_error_at_values(settings: ProblemSettings, values: Floats) -> float:
    """Rms error (m or rad) of the visits at other values."""
    return _rms_in_space(settings, settings.whitened_residuals(values).reshape(-1))


def _rms_in_space(settings: ProblemSettings, whitened: Floats) -> float:
    return settings.source.rms(settings.whitening.back(whitened)[settings.used])


def noise_rms(settings: ProblemSettings) -> float:
    """Rms length in space (m; rad of a joint) that the noise alone gives a visit."""
    size = settings.whitener.shape[-1]
    root = cholesky_root(np.mean(settings.of_visit, axis=0)).T * np.sqrt(size)
    return settings.source.rms(root)


def displacement_by_columns(problem: LinearizedProblem, own: Sequence[int]) -> Floats:
    """Displacement (V, m) in m or rad by the library columns ``own`` at the values of the fit, which a version stores."""
    return problem.settings.source.in_space(weighted_displacement(problem, own))


def weighted_displacement(problem: LinearizedProblem, own: Sequence[int]) -> Floats:
    """The same as residuals have it: of views, as these weigh it."""
    index = list(own)
    amount = problem.settings.source.library(problem.values)[index] * problem.size[index]
    return problem.settings.whitening.back(problem.W_raw[:, index] @ amount)


def displacement_derivatives(problem: LinearizedProblem, own: Sequence[int]) -> Floats:
    """How what was measured (V, m, d) moves in m or rad with each of the library columns ``own``."""
    columns = problem.W_raw[:, list(own)] * problem.size[list(own)]
    each = [problem.settings.whitening.back(column) for column in columns.T]
    return problem.settings.source.in_space(np.stack(each, axis=2))


def cholesky_root(covariance: Floats) -> Floats:
    """Lower triangular root (..., m, m) of covariances."""
    return np.asarray(np.linalg.cholesky(covariance + 1e-20 * np.eye(covariance.shape[-1])), dtype=np.float64)
