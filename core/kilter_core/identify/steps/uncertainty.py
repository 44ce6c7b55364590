"""How far a fit is known: its covariance by what rows scatter and masses may be off, its intervals, and its prediction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from kilter_core.effects.load_error import LoadError
from kilter_core.identify.carried_masses import beside_drawn_masses, considered_masses
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.rows.noise import Repeats
from kilter_core.identify.setup_frames import marginal, of_the_arm
from kilter_core.identify.steps.fit import Fitted
from kilter_core.identify.steps.start import Study
from kilter_core.identify.steps.validation import HeldOut
from kilter_core.identify.uncertainty.by_views import predictive_of_views, tool_sigma_from_views
from kilter_core.identify.uncertainty.intervals import Intervals, bootstrap, profile
from kilter_core.identify.uncertainty.predictive import Predictive, predictive
from kilter_core.identify.uncertainty.stated_noise import BeyondNoise
from kilter_core.identify.uncertainty.structure import Structure
from kilter_core.identify.view_report import views_document, with_own_scatter
from kilter_core.types import Each, Floats, Progress


@dataclass(frozen=True)
class Uncertainty:
    """How far the fit of a study is known.

    ``fit`` has the covariance to report, ``arm_fit`` is the same without the frames of set-ups, cameras and boards.
    ``beyond`` is what rows leave beyond the stated noise, ``masses`` are errors of masses that the covariance holds and no
    parameter, ``views`` says where cameras and boards are and how far off the tool is in what they see.
    """

    fit: Fit
    arm_fit: Fit
    repeats: Repeats
    beyond: BeyondNoise | None
    masses: LoadError | None
    intervals: Intervals | None
    predictive: Predictive
    views: dict[str, Any]


def estimate_uncertainty(study: Study, fitted: Fitted, held: HeldOut, each: Each, progress: Progress) -> Uncertainty:
    """Widen the covariance of a fit to what its rows scatter, then find intervals and what a prediction may be off by."""
    options, plain, arm = study.options, fitted.fit, fitted.arm
    repeats = Repeats.from_observations(study.train, plain.residual)
    clustered, scatter = with_own_scatter(plain)
    beyond = BeyondNoise.from_fit(clustered, repeats, options.noise_m)
    masses = considered_masses(arm.model.effects, arm.robot, study.train, options)
    predicted = clustered if beyond is None else beyond.widen(clustered)
    fit = predicted if masses is None else beside_drawn_masses(plain, predicted, masses)
    wider = (1.0 if beyond is None else beyond.widening) * fit.sigma / predicted.sigma
    if scatter is None:
        lack = Structure.from_fit(plain), tool_sigma_from_views(plain)
        prediction = predictive(marginal(predicted), repeats, options.noise_m, *lack)
    else:
        prediction = predictive_of_views(fit, scatter)
    return Uncertainty(
        fit=fit,
        arm_fit=marginal(fit),
        repeats=repeats,
        beyond=beyond,
        masses=masses,
        intervals=_intervals(options, plain, fit, wider, each, progress),
        predictive=prediction,
        views=views_document(arm, clustered, scatter, fitted.begin, held.views),
    )


def _intervals(
    options: IdentifyOptions, plain: Fit, fit: Fit, wider: Floats, each: Each, progress: Progress
) -> Intervals | None:
    """Intervals of a fit; a profile, whose likelihood takes rows as independent, is widened to what the poses show."""
    if options.intervals is None:
        return None
    if options.intervals == "profile":
        found = profile(plain, progress, each).widen_by_factor(fit.sigma / plain.sigma)
    else:
        found = bootstrap(plain, options.seed, progress).widen_by_factor(wider)
    arm = of_the_arm(fit)
    return replace(found, lower=found.lower[arm], upper=found.upper[arm], stands_in=found.stands_in[arm])
