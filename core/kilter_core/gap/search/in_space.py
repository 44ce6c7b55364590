"""Sizes in space (m, rad) of what a search holds whitened: errors of the visits, noise, and what an effect moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kilter_core.gap.search.linearized import LinearizedProblem, ProblemSettings, fitted
from kilter_core.gap.search.scan import residual_given
from kilter_core.gap.search.source import LinkSource
from kilter_core.types import Floats


def rms(errors: Floats, lower: Floats, joints: bool = False) -> float:
    """Root mean square size of the error of a point (m), or of a joint (rad), from whitened errors (V, m)."""
    e = errors @ lower.T
    if joints:
        return float(np.sqrt(np.mean(e**2)))
    points = e[:, : 3 * max(1, e.shape[1] // 3)] if e.shape[1] % 3 == 0 and e.shape[1] != 6 else e[:, :3]
    return float(np.sqrt(np.mean(np.sum(points**2, axis=1)) / max(1, points.shape[1] // 3)))


def train_rms(problem: LinearizedProblem, columns: Sequence[int]) -> float:
    """Rms error (m or rad) of the visits at a set of columns, geometry re-fitted."""
    return _rms_of(problem.settings, residual_given(problem, columns))


def fit_rms(problem: LinearizedProblem) -> float:
    """Rms error (m or rad) of the visits at the values of the fit itself: what a version that holds them leaves."""
    return _rms_of(problem.settings, problem.raw)


def _rms_of(settings: ProblemSettings, whitened: Floats) -> float:
    r = whitened.reshape(-1, settings.whitener.shape[-1])
    e = np.einsum("vij,vj->vi", np.linalg.inv(settings.whitener), r)[settings.used]
    return rms(e, np.eye(e.shape[1]), isinstance(settings.source, LinkSource))


def noise_rms(settings: ProblemSettings) -> float:
    """Rms length in space (m; rad of a joint) that the noise alone gives a visit."""
    size = settings.whitener.shape[-1]
    root = root_of(np.mean(settings.noise.visit, axis=0)).T * np.sqrt(size)
    return rms(root, np.eye(size), isinstance(settings.source, LinkSource))


def moved_by(problem: LinearizedProblem, columns: Sequence[int], own: Sequence[int]) -> Floats:
    """Displacement (V, m) in m or rad by the library columns ``own`` at their fitted values."""
    values, _ = fitted(problem, columns)
    amount = np.array([values[list(columns).index(k)] * problem.size[k] for k in own])
    white = (problem.W_raw[:, list(own)] @ amount).reshape(-1, problem.settings.whitener.shape[-1])
    return np.asarray(np.einsum("vij,vj->vi", np.linalg.inv(problem.settings.whitener), white))


def root_of(covariance: Floats) -> Floats:
    """Lower triangular root (m, m) of a covariance."""
    return np.asarray(np.linalg.cholesky(covariance + 1e-20 * np.eye(len(covariance))), dtype=np.float64)
