"""One stacked linear solve (thesis eq. 2.9 and 3.5 with all poses at once), and what the linearisation missed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.identify.estimate import estimate_weights, prepare_problem
from kilter_core.identify.fit.least_squares import Fit, build_fit
from kilter_core.identify.options import IdentifyOptions
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.types import Progress


def linear_least_squares(
    start: Calibration, measurement: Measurement, options: IdentifyOptions, progress: Progress | None = None
) -> Fit:
    """Solve the problem linearised at the start, within the priors, once; base and tool are registered first.

    ``linear_error`` in the report is what the linearisation missed: the largest change of a residual, in its standard
    deviations, between what the linear step promised and what the model then says.
    """
    problem, values = prepare_problem(start, measurement, options)
    here = problem.linearise(values)
    step = problem.whole_step(values, here)
    values = problem.apply_step(values, step)
    promised = problem.beyond(here, values, step)
    first = build_fit(problem, values, problem.linearise(values), 1)
    problem = problem.with_weights(estimate_weights(first, options), None)
    fit = build_fit(problem, values, problem.linearise(values, first.residual), 1)
    missed = first.residual.points - promised.residual.points
    size = float(np.nanmax(np.abs(missed / problem.weights.points), initial=0.0))
    if progress is not None:
        progress(1.0, "solved")
    return replace(fit, report={"linear_error": size})
