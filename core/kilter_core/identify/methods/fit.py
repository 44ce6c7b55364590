"""A fit by the method that the options name, taken again while the loads on the fitted chain differ from those it took."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.errors import NotConvergedError
from kilter_core.identify.estimate import estimate, prepare_problem
from kilter_core.identify.fit.least_squares import Fit, build_fit
from kilter_core.identify.fleet.believed import fit_with_fleet_prior
from kilter_core.identify.methods.kalman import Prior
from kilter_core.identify.methods.loads import ROUNDS, continue_fit, model_with_updated_loads
from kilter_core.identify.methods.signs import (
    SHARPENINGS,
    likelier,
    model_with_sharpened_signs,
    model_with_softened_signs,
)
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.registry import METHODS
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration, RobotModel
from kilter_core.types import Progress


def fit_by_method(
    start: Calibration,
    measurement: Measurement,
    options: IdentifyOptions,
    progress: Progress | None = None,
    prior: Prior | None = None,
) -> Fit:
    """Fit by the method the options name, and again while loads on the fitted chain differ from those it took.

    Only ``kalman`` continues from a ``prior``. With ``tilt_first`` the effects of the start are held (thesis 4.22, 5.20);
    a start that has none of their values gets them fitted first, the chain held at its nominal values. A model that knows
    its type is fitted without and with that.
    """
    if start.model.of_type is None:
        return _by_method(start, measurement, options, progress, prior)
    return fit_with_fleet_prior(start, options, lambda begin: _by_method(begin, measurement, options, progress, prior))


def _by_method(
    start: Calibration,
    measurement: Measurement,
    options: IdentifyOptions,
    progress: Progress | None,
    prior: Prior | None,
) -> Fit:
    asked = measurement, options, prior
    try:
        fit = _refit_at_fitted_loads(start, _fit_once(start, measurement, options, progress, prior), *asked)
    except NotConvergedError as endless:  # the loss of sharp signs has steps, on which masses may walk to and fro
        soft = model_with_softened_signs(_at_start(start, measurement, options))
        if soft is None:
            raise
        try:
            return _with_signs_of(soft, start, *asked)
        except NotConvergedError:
            raise endless from None
    soft = model_with_softened_signs(fit)
    if soft is None:
        return fit
    try:
        other = _with_signs_of(soft, start, *asked)
    except NotConvergedError:  # the fit with sharp signs stands
        return fit
    return other if likelier(other, fit) else fit


def _at_start(start: Calibration, measurement: Measurement, options: IdentifyOptions) -> Fit:
    problem, values = prepare_problem(start, measurement, options)
    return build_fit(problem, values, problem.linearise(values))


def _with_signs_of(
    soft: RobotModel, start: Calibration, measurement: Measurement, options: IdentifyOptions, prior: Prior | None
) -> Fit:
    """The fit that begins with signs as soft as those of a model."""
    begin = replace(start, model=replace(start.model, effects=soft.effects))
    return _refit_with_sharper_signs(
        start, _fit_once(begin, measurement, options, None, prior), measurement, options, prior
    )


def _refit_at_fitted_loads(
    start: Calibration, fit: Fit, measurement: Measurement, options: IdentifyOptions, prior: Prior | None
) -> Fit:
    """Fit again at the loads that a fit leads to, until they change nothing that counts."""
    for _ in range(ROUNDS - 1):
        model = model_with_updated_loads(fit)
        if model is None:
            break
        try:
            fit = _refit_with_model(start, model, fit, measurement, options, prior)
        except NotConvergedError:  # the fit that ended stands, at the loads that it took
            break
    return fit


def _refit_with_sharper_signs(
    start: Calibration, fit: Fit, measurement: Measurement, options: IdentifyOptions, prior: Prior | None
) -> Fit:
    """Fit again with signs as soft as the fit before leaves the loads, until that changes no sign that matters."""
    for _ in range(SHARPENINGS):
        model = model_with_sharpened_signs(fit, start.model, model_with_updated_loads(fit))
        if model is None:
            break
        fit = _refit_with_model(start, model, fit, measurement, options, prior)
    return fit


def _refit_with_model(
    start: Calibration,
    model: RobotModel,
    fit: Fit,
    measurement: Measurement,
    options: IdentifyOptions,
    prior: Prior | None,
) -> Fit:
    """The fit with the loads of ``model``: from where it ended, or by a method that has to begin anew from the start."""
    again = METHODS[options.method].again
    if again and options.loss != "tukey" and not options.tilt_first:
        found = continue_fit(fit, model, options)
    else:
        begin = replace(start, model=replace(start.model, effects=model.effects, load_chain=model.load_chain))
        found = _fit_once(begin, measurement, replace(options, method=again or options.method), None, prior)
    return replace(found, iterations=fit.iterations + found.iterations, report={**fit.report, **found.report})


def _fit_once(
    start: Calibration,
    measurement: Measurement,
    options: IdentifyOptions,
    progress: Progress | None,
    prior: Prior | None,
) -> Fit:
    begin = start
    if options.tilt_first and _knows_no_effect(start):
        begin = _fit_effects_first(start, measurement, options)
    method = METHODS[options.method]
    known = (prior,) if method.continues else ()
    fit: Fit = method.fitter()(begin, measurement, options, progress, *known)
    if not options.tilt_first:
        return fit
    return replace(fit, report={**fit.report, "effects": "held" if begin is start else "fitted first"})


def _knows_no_effect(start: Calibration) -> bool:
    effects = slice(start.model.n_geometric, None)
    some = len(start.names) > start.model.n_geometric
    return some and np.array_equal(start.values[effects], start.model.values0()[effects])


def _fit_effects_first(start: Calibration, measurement: Measurement, options: IdentifyOptions) -> Calibration:
    """The start with its effects fitted beside base and tool, the chain held."""
    model = start.model
    chain = model.names[6 : model.n_geometric - 6]
    fit = estimate(start, measurement, replace(options, tilt_first=False, method="least_squares", free=(), fix=chain))
    values = start.values.copy()
    values[model.n_geometric :] = fit.values[model.n_geometric :]
    return replace(start, values=values)
