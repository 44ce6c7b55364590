"""A fit that believes the arm's type as far as the arm lets it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from kilter_core.errors import CoreError, NotConvergedError, TooFewPosesError
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.fit.prior_use import PriorUse
from kilter_core.identify.fleet.conflict import LOOSE, assess_prior_conflict
from kilter_core.identify.fleet.limited import required_prior_widening
from kilter_core.identify.options import IdentifyOptions
from kilter_core.model import Calibration
from kilter_core.parameters import TypePrior


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
    start: Calibration, prior: TypePrior, options: IdentifyOptions, fitted: Callable[[Calibration], Fit]
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


def _as_used(prior: TypePrior, use: PriorUse) -> TypePrior:
    return prior.widen_parameters(use.odd, LOOSE).widen_by_factor(use.widened_by or 1.0)


def _with_type_prior(start: Calibration, prior: TypePrior | None) -> Calibration:
    return replace(start, model=replace(start.model, of_type=prior))
