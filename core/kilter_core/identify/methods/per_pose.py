"""One pose at a time, then the mean of all: the pseudo-inverse of thesis 3.6 and its weighting by influence (3.7, 3.8).

A position gives three equations for twenty unknowns, so each pose has a whole space of explanations. The pseudo-inverse
takes the smallest, counted in prior sigmas; the influence weights k take the one that moves influential parameters most.
The parameters move by the mean over all poses, and all poses are asked again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from kilter_core.errors import NotConvergedError
from kilter_core.identify.estimate import estimate_weights, prepare_problem
from kilter_core.identify.fit.least_squares import Fit, Problem, build_fit
from kilter_core.identify.measured_rows import imposed_step, relative_influence
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.uncertainty.clustered import with_clustered_covariance
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.types import Floats, Progress

SWEEPS = 400
SETTLED = 1e-5  # largest mean step, in prior sigmas, that ends the sweeps: 50 nm, 10 millionths of a degree
GAIN = 0.5  # C < 1 of thesis 3.8
RESOLUTION_M = 1e-5  # of the thesis's instrument: a pose is explained when less is left
INNER = 400
SMALLEST_SHARE = 1e-10  # singular values of a pose below this share of its largest are zero (three markers have rank 6)


def pose_pseudo_inverse(
    start: Calibration, measurement: Measurement, options: IdentifyOptions, progress: Progress | None = None
) -> Fit:
    """Mean of the per-pose solutions Jᵀ(J Jᵀ)⁻¹ ΔP, repeated until it settles (thesis eq. 3.6, corrected)."""
    return _by_poses(start, measurement, options, progress, lambda problem, J: np.ones((len(J), J.shape[2])), 1.0)


def influence(
    start: Calibration, measurement: Measurement, options: IdentifyOptions, progress: Progress | None = None
) -> Fit:
    """As the per-pose pseudo-inverse, each pose weighted by its influence vector k (thesis eq. 3.7, 3.8, corrected)."""
    return _by_poses(start, measurement, options, progress, _influence_weights, GAIN)


def pose_solutions(J: Floats, r: Floats, k: Floats, gain: float, resolution: float) -> Floats:
    """Parameter errors (N, F) that explain ``r (N, R)`` pose by pose: damped fixed point ΔE = k ∘ gain J⁺ ΔP.

    Iterated with J (N, R, F) held until less than ``resolution`` is left. It tends to K Jᵀ(J K Jᵀ)⁻¹ r with K = diag(k).
    """
    inverse = np.linalg.pinv(J @ J.transpose(0, 2, 1), rcond=SMALLEST_SHARE, hermitian=True)
    back = J.transpose(0, 2, 1) @ inverse
    kept = np.eye(J.shape[1]) - gain * (J * k[:, None, :]) @ back
    left, used = r.copy(), np.zeros_like(r)
    for _ in range(INNER):
        used += left
        left = np.einsum("nij,nj->ni", kept, left)
        if np.max(np.abs(left), initial=0.0) < resolution:
            break
    return np.asarray(gain * k * np.einsum("nfi,ni->nf", back, used))


def _by_poses(
    start: Calibration,
    measurement: Measurement,
    options: IdentifyOptions,
    progress: Progress | None,
    weigh: Callable[[Problem, Floats], Floats],
    gain: float,
) -> Fit:
    problem, values = prepare_problem(start, measurement, options)
    resolution = RESOLUTION_M / float(np.mean(problem.weights.points))
    for sweep in range(1, SWEEPS + 1):
        J, r = problem.by_row(problem.linearise(values))
        k = weigh(problem, J)
        steps = pose_solutions(J, r, k, gain, resolution)
        mean = steps.mean(axis=0)
        values[problem.free] += mean * problem.prior_sigma
        if not np.isfinite(values).all():
            raise NotConvergedError("The poses contradict each other beyond all bounds: use method least_squares.")
        if progress is not None:
            progress(1.0 - 0.99**sweep, f"sweep {sweep}")
        if np.max(np.abs(mean), initial=0.0) < SETTLED:
            break
    return _fit_with_pose_scatter(problem, values, sweep, steps, options)


def _influence_weights(problem: Problem, J: Floats) -> Floats:
    steps = np.array([imposed_step(problem.model.parameters[k]) for k in problem.free]) / problem.prior_sigma
    return relative_influence(np.linalg.norm(J[:, :3], axis=1) * steps)


def _fit_with_pose_scatter(
    problem: Problem, values: Floats, sweeps: int, steps: Floats, options: IdentifyOptions
) -> Fit:
    """The fit with its noise, and a covariance widened by how far the poses disagree about the mean, repeats as one."""
    first = build_fit(problem, values, problem.linearise(values), sweeps)
    problem = problem.with_weights(estimate_weights(first, options), None)
    fit = with_clustered_covariance(build_fit(problem, values, problem.linearise(values), sweeps))
    groups = problem.measurement.observations.pose_groups()
    scaled = (steps - steps.mean(axis=0)) * problem.prior_sigma
    together = np.stack([np.bincount(groups, weights=column) for column in scaled.T], axis=1)
    disagreement = together.T @ together / len(steps) ** 2 * len(together) / max(len(together) - 1, 1)
    report = {"sweeps": sweeps, "settled": sweeps < SWEEPS}
    return replace(fit, covariance=fit.covariance + disagreement, report=report)
