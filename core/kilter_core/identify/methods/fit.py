"""A fit by the method that the options name, taken again while the loads on the fitted chain differ from those it took."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from kilter_core.errors import CoreError, NotConvergedError, TooFewPosesError
from kilter_core.identify.carried_masses import of_masses
from kilter_core.identify.estimate import (
    WEIGHT_PASSES,
    estimate,
    estimate_weights,
    has_sigma_settled,
    prepare_problem,
    scatter,
)
from kilter_core.identify.fit.least_squares import Fit, PriorUse, Weights, build_fit, solve
from kilter_core.identify.fleet_report import LOOSE, assess_prior_conflict, required_prior_widening
from kilter_core.identify.methods.kalman import Prior
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.registry import METHODS
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration, RobotModel
from kilter_core.model.prediction import load_sign_blur
from kilter_core.observations import Observations
from kilter_core.parameters import CorrelatedPrior
from kilter_core.types import Floats, Progress

# Signs of loads while masses are uncertain: as soft as the masses leave the loads, from their priors to what the
# data say.
#
# An effect with a sharp sign is blind to the masses that decide where it changes: its loss is flat but for steps, so
# a fit stays with the masses it began with. Read as its expectation over the masses the sign is a smooth curve; a
# fit finds the masses by it, which then leave the loads less uncertain and the sign sharper, until nothing changes
# any more. Where the masses are as stated nothing of that is needed: of the two fits the likelier stands.

SHARPENINGS = 4
CHANGED = 0.1  # of a width: less moves no sign that matters


def model_with_softened_signs(fit: Fit) -> RobotModel | None:
    """The model of a fit with signs as soft as the priors of the masses leave the loads; None where no sign is in doubt."""
    problem = fit.problem
    own = of_masses(problem.model)[problem.free]
    if not own.any():
        return None
    model = problem.model
    made = _as_soft(model, model, problem.measurement.observations, fit.values, np.diag(problem.prior_sigma[own] ** 2))
    return made if np.any(_widths(made) > _widths(model)) else None


def model_with_sharpened_signs(fit: Fit, sharp: RobotModel, reloaded: RobotModel | None) -> RobotModel | None:
    """The model of a fit with signs as soft as its posterior of the masses leaves the loads; None where nothing changes.

    ``sharp`` has the effects with widths of their own, below which none goes; ``reloaded`` is the model with its loads on
    the chain that was fitted, where those differ.
    """
    problem = fit.problem
    own = of_masses(problem.model)[problem.free]
    known = fit.covariance[np.ix_(own, own)]
    model = problem.model if reloaded is None else reloaded
    made = _as_soft(model, sharp, problem.measurement.observations, fit.values, known)
    before, after = _widths(problem.model), _widths(made)
    return reloaded if np.all(np.abs(after - before) <= CHANGED * before) else made


def likelier(one: Fit, other: Fit) -> bool:
    """Whether the first fit is likelier than the other: by what each leaves of the rows, and by their priors."""
    return _surprise(one) < _surprise(other)


def _surprise(fit: Fit) -> float:
    """Minus the logarithm of the posterior density, up to a constant, each noise group with the scatter that it shows."""
    problem, left = fit.problem, scatter(fit)
    moved = (fit.values[problem.free] - problem.prior_mean) / problem.prior_sigma
    seen = sum(
        float(np.count_nonzero(~np.isnan(block.r))) * math.log(max(left[block.group], TINY))
        for block in fit.residual.blocks
    )
    return seen + 0.5 * float(moved @ moved)


TINY = 1e-12


def _as_soft(
    model: RobotModel, sharp: RobotModel, rows: Observations, values: Floats, covariance: Floats
) -> RobotModel:
    batch = model.apply_load_errors(model.batch(rows), values)
    soft = replace(batch, blur=load_sign_blur(model.effects, batch, covariance))
    return replace(model, effects=tuple(effect.with_softened_signs(soft) for effect in sharp.effects))


def _widths(model: RobotModel) -> Floats:
    """Half-widths of the signs, N m, joint by joint of each effect that has one."""
    n = model.robot.n_joints
    found = (
        np.broadcast_to(effect.softening_nm, len(effect.acting(n)))
        for effect in model.effects
        if hasattr(effect, "softening_nm")
    )
    return np.concatenate([np.zeros(0), *found])


def fit_with_fleet_prior(start: Calibration, options: IdentifyOptions, fitted: Callable[[Calibration], Fit]) -> Fit:
    """Fit from ``start``, whose model has a type, by ``fitted``: without the type, to judge the arm, and then with it.

    Raises:
        CoreError: ``fleet_conflict``: the arm is not as its type, and these poses are too few without it.
        NotConvergedError: no minimum found.

    """
    prior = start.model.of_type
    assert prior is not None
    alone = _alone(start, fitted)
    if alone is None:
        return _without_a_judge(start, prior, options, fitted)
    use = assess_prior_conflict(alone, prior, options.noise_mm is not None)
    if use.widened_by is None:
        return replace(alone, prior_use=use)
    use = _limit_prior_use(use, required_prior_widening(alone, _as_used(prior, use), use.noise))
    return replace(fitted(_with_type_prior(start, _as_used(prior, use))), prior_use=use)


def _limit_prior_use(use: PriorUse, by: float) -> PriorUse:
    """The use of a prior that is taken wider still, so that it moves the arm by little enough."""
    if use.widened_by is None or by <= 1.0:
        return use
    return replace(use, state="widened", widened_by=use.widened_by * by, limited_by=by)


def _alone(start: Calibration, fitted: Callable[[Calibration], Fit]) -> Fit | None:
    """The fit without the type; None where the poses are too few for one."""
    try:
        return fitted(_with_type_prior(start, None))
    except (TooFewPosesError, NotConvergedError):
        return None


def _without_a_judge(
    start: Calibration, prior: CorrelatedPrior, options: IdentifyOptions, fitted: Callable[[Calibration], Fit]
) -> Fit:
    """A fit of so few poses that none without the type stands beside it: judged by itself."""
    fit = fitted(start)
    use = assess_prior_conflict(fit, prior, options.noise_mm is not None)
    if use.widened_by is None:
        raise CoreError(
            f"This arm is not as its type (chi-square {use.chi_square:.3g} in {use.compared} directions), and these poses "
            "are too few to identify it without its type: measure more poses, and leave prior fleet out.",
            code="fleet_conflict",
            chi_square=use.chi_square,
            compared=use.compared,
        )
    if use.state == "used":
        return replace(fit, prior_use=use)
    return replace(fitted(_with_type_prior(start, _as_used(prior, use))), prior_use=use)


def _as_used(prior: CorrelatedPrior, use: PriorUse) -> CorrelatedPrior:
    return prior.widen_parameters(use.odd, LOOSE).widen_by_factor(use.widened_by or 1.0)


def _with_type_prior(start: Calibration, prior: CorrelatedPrior | None) -> Calibration:
    return replace(start, model=replace(start.model, of_type=prior))


# Loads on the fitted chain: taken anew between fits, for what a fit moves of the chain moves the weights that hang
# on it.
#
# A joint zero of one degree changes moments by percents. Within a fit the chain of the loads stands still, so the
# Jacobian stays exact; a fit that moved it goes on with the loads it leads to, until they change nothing that the
# data could show.

ROUNDS = 3  # of loads: where the poses tell the chain, each moves it a hundredth as far as the one before
# Norm of what new loads move of all rows, in sigmas: no parameter, nor any sum of them, moves by more than this share of
# its own standard deviation.
SETTLED = 0.1


def model_with_updated_loads(fit: Fit) -> RobotModel | None:
    """The model of a fit with its loads on the chain that was fitted; None where that moves nothing that counts."""
    problem = fit.problem
    if not any("moments" in effect.needs for effect in problem.model.effects):
        return None
    other = replace(problem, model=problem.model.with_loads_at_values(fit.values))
    moved = np.linalg.norm(other.whitened_residuals(fit.values) - problem.whitened_residuals(fit.values))
    return other.model if moved > SETTLED else None


def continue_fit(fit: Fit, model: RobotModel, options: IdentifyOptions) -> Fit:
    """Fit another ``model`` of the same parameters from where a fit ended, its weights following the residuals.

    What that fit held stays held.

    Raises:
        NotConvergedError: no minimum found.

    """
    found = solve(replace(fit.problem, model=model), fit.values)
    walked = found.iterations
    for _ in range(WEIGHT_PASSES):
        problem = found.problem
        weights = estimate_weights(found, options)
        if _are_weights_settled(weights, problem.weights):
            break
        found = solve(problem.with_weights(weights, problem.held), found.values, known=found.residual)
        walked += found.iterations
    return replace(found, iterations=walked)


def _are_weights_settled(one: Weights, other: Weights) -> bool:
    sizes = (float(np.mean(one.points)), float(np.mean(other.points)))
    groups = ((sigma, float(other.group_sigma(group))) for group, sigma in one.others.items())
    return (
        has_sigma_settled(*sizes)
        and has_sigma_settled(one.turns, other.turns)
        and all(has_sigma_settled(*pair) for pair in groups)
    )


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
