"""Search of a whole box of parameters for gross errors, then least squares from the best place found.

Differential evolution (Storn and Price) over the chain's free parameters; base and tool are registered anew for every
candidate, so neither needs a guess. It needs no slope and leaves a wrong valley, at thousands of model runs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.errors import NotConvergedError, OptionError
from kilter_core.identify.estimate import estimate, prepare_problem
from kilter_core.identify.fit.least_squares import Fit, Problem
from kilter_core.identify.options import IdentifyOptions
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.parameters import mm
from kilter_core.transforms import nearest_rotation
from kilter_core.types import Floats, Ints, Progress

POSES = 40  # enough to tell valleys apart; the least squares afterwards uses all
POPULATION = 4
GENERATIONS = 40
BETTER = 0.99  # share of the start's squared error below which the place the search found counts as better


@dataclass(frozen=True)
class _Search:
    """The cost of a candidate: root mean square distance (m) once the base is laid over it (``base``)."""

    problem: Problem
    values: Floats
    searched: Ints
    span: Floats
    base: bool

    def candidate_values(self, x: Floats) -> Floats:
        values = self.values.copy()
        values[self.searched] += x * self.span
        return values

    def __call__(self, x: Floats) -> float:
        prediction = self.problem.model.predict(self.problem.batch, self.candidate_values(x))
        left = self.problem.measurement.residual(prediction).points.reshape(-1, 3)
        if self.base:
            shape = self.problem.measurement.marker_points
            arms = np.zeros((1, 3)) if shape is None else shape
            there = (prediction.position[:, None] + np.einsum("nij,mj->nmi", prediction.rotation, arms)).reshape(-1, 3)
            left = _after_base(there, there + left)
        return float(np.sqrt(np.nanmean(left**2)))


def _after_base(predicted: Floats, measured: Floats) -> Floats:
    """Distances (K, 3) left between two clouds once one is rotated and moved onto the other."""
    seen = ~np.isnan(measured).any(axis=1)
    p, m = predicted[seen], measured[seen]
    p, m = p - p.mean(axis=0), m - m.mean(axis=0)
    return np.asarray(m - p @ nearest_rotation(m.T @ p).T)


def global_search(
    start: Calibration, measurement: Measurement, options: IdentifyOptions, progress: Progress | None = None
) -> Fit:
    """Fit from the best of a box of ``search_mm`` and ``search_deg`` about the start, and from the start itself.

    Raises:
        OptionError: no chain parameter is free. NotConvergedError: no minimum from either place.

    """
    problem, values = prepare_problem(start, measurement, options)
    search = _search(problem, values, options)
    best = _run_differential_evolution(search, options.seed, progress)
    there = np.concatenate([search.candidate_values(best.x), values[problem.model.n_geometric :]])
    found = Calibration(problem.model, there, start.marker_points)
    fits = [
        fit
        for fit in (_try_estimate(found, measurement, options, values), _try_estimate(start, measurement, options))
        if fit
    ]
    if not fits:
        raise NotConvergedError(
            "Neither the place the search found nor the start leads to a minimum: widen search_mm or search_deg, "
            "fix parameters, or look for swapped columns.",
        )
    fit = fits[0] if _mean_squared_error(fits[0]) < BETTER * _mean_squared_error(fits[-1]) else fits[-1]
    report = {
        "evaluations": int(best.nfev),
        "best_mm": mm(float(best.fun)),
        "start_mm": mm(search(np.zeros(len(search.span)))),
        "needed": len(fits) == 1 or fit is not fits[-1],
    }
    return replace(fit, report=report)


def _search(problem: Problem, values: Floats, options: IdentifyOptions) -> _Search:
    """The box over chain and tool point; the effects' hundredths of a millimetre are left out."""
    n = problem.model.n_geometric
    chain = problem.free[(problem.free >= 6) & (problem.free < n - 6)]
    if len(chain) == 0:
        raise OptionError("global_search needs a free chain parameter: ask for level 1 or 2.", option="method")
    tool = problem.free[(problem.free >= n - 6) & (problem.free < n - 3)]
    searched = np.concatenate([chain, tool])
    model = replace(problem.model, effects=())
    span = np.array([options.search_span[model.parameters[k].unit] for k in searched])
    o = problem.measurement.observations
    some = np.random.default_rng(options.seed).permutation(len(o))[:POSES]
    few = Measurement(o.select(some), problem.measurement.marker_points)
    base = bool(np.any(problem.free < 6))
    return _Search(Problem(model, few, searched, problem.weights), values[:n], searched, span, base)


def _run_differential_evolution(search: _Search, seed: int, progress: Progress | None) -> Any:
    import scipy.optimize  # 15 MB, which the API does without

    generation = 0

    def grown(intermediate_result: Any) -> None:
        nonlocal generation
        generation += 1
        if progress is not None:
            progress(0.8 * generation / GENERATIONS, f"generation {generation} of {GENERATIONS}")

    one = np.ones(len(search.span))
    return scipy.optimize.differential_evolution(
        search,
        scipy.optimize.Bounds(-one, one),
        maxiter=GENERATIONS,
        popsize=POPULATION,
        polish=False,
        x0=0.0 * one,
        callback=grown,
        tol=1e-6,
        rng=np.random.default_rng(seed),
    )


def _try_estimate(
    begin: Calibration, measurement: Measurement, options: IdentifyOptions, anchor: Floats | None = None
) -> Fit | None:
    try:
        return estimate(begin, measurement, options, anchor=anchor)
    except (NotConvergedError, np.linalg.LinAlgError):
        return None


def _mean_squared_error(fit: Fit) -> float:
    return float(np.nanmean(fit.residual.points**2))
