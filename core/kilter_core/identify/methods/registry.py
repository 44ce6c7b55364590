"""Every method of identification behind one interface. Adding one is its file and one line here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from kilter_core.errors import NotConvergedError
from kilter_core.identify.estimate import Progress, estimate
from kilter_core.identify.least_squares import Fit
from kilter_core.identify.methods.global_search import global_search
from kilter_core.identify.methods.kalman import Prior, kalman
from kilter_core.identify.methods.linear import linear_least_squares
from kilter_core.identify.methods.loads import ROUNDS, continued, reloaded
from kilter_core.identify.methods.per_pose import influence, pose_pseudo_inverse
from kilter_core.identify.options import IdentifyOptions
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration, RobotModel

Fitter = Callable[[Calibration, Measurement, IdentifyOptions, Progress | None], Fit]


@dataclass(frozen=True)
class Method:
    """A way to fit.

    ``minimum`` says that it ends at a least-squares minimum, which intervals rest on; ``lets_rows_go`` that it goes with
    loss "tukey"; ``summary`` is its line in `kilter methods`.
    """

    fit: Fitter
    summary: str = ""
    minimum: bool = False
    lets_rows_go: bool = False


ESTIMATORS: Mapping[str, Method] = MappingProxyType({
    "least_squares": Method(
        estimate, "all poses together, weighted, with the exact Jacobian; take it first", minimum=True, lets_rows_go=True
    ),
    "pose_pseudo_inverse": Method(pose_pseudo_inverse, "pose by pose, and the mean of the answers (thesis 3.6)"),
    "influence": Method(influence, "pose by pose, each weighted by its influence (thesis 3.7, 3.8)"),
    "kalman": Method(kalman, "continue a version with the rows of a new campaign alone", minimum=True),
    "global_search": Method(
        global_search, "search a box first: zeros off by a turn, another drawing", minimum=True, lets_rows_go=True
    ),
    "linear_least_squares": Method(linear_least_squares, "the problem linearised at the start, solved once"),
})  # fmt: skip


def fit_by_method(
    start: Calibration,
    measurement: Measurement,
    options: IdentifyOptions,
    progress: Progress | None = None,
    prior: Prior | None = None,
) -> Fit:
    """Fit by the method the options name, and again while loads on the fitted chain differ from those it took.

    Only ``kalman`` continues from a ``prior``. With ``tilt_first`` the effects of the start are held (thesis 4.22, 5.20);
    a start that has none of their values gets them fitted first, the chain held as drawn.
    """
    fit = _fitted(start, measurement, options, progress, prior)
    for _ in range(ROUNDS - 1):
        model = reloaded(fit)
        if model is None:
            break
        try:
            fit = _again(start, model, fit, measurement, options, prior)
        except NotConvergedError:  # the fit that ended stands, at the loads that it took
            break
    return fit


def _again(
    start: Calibration,
    model: RobotModel,
    fit: Fit,
    measurement: Measurement,
    options: IdentifyOptions,
    prior: Prior | None,
) -> Fit:
    """The fit with the loads of ``model``: from where it ended, or by a method that has to begin anew from the start."""
    if options.method in ("least_squares", "global_search") and options.loss != "tukey" and not options.tilt_first:
        found = continued(fit, model, options)
    else:
        begin = replace(start, model=replace(start.model, load_chain=model.load_chain))
        method = "least_squares" if options.method == "global_search" else options.method
        found = _fitted(begin, measurement, replace(options, method=method), None, prior)
    return replace(found, iterations=fit.iterations + found.iterations, report={**fit.report, **found.report})


def _fitted(
    start: Calibration,
    measurement: Measurement,
    options: IdentifyOptions,
    progress: Progress | None,
    prior: Prior | None,
) -> Fit:
    begin = start
    if options.tilt_first and _knows_no_effect(start):
        begin = _tilted(start, measurement, options)
    if options.method == "kalman":
        fit = kalman(begin, measurement, options, progress, prior)
    else:
        fit = ESTIMATORS[options.method].fit(begin, measurement, options, progress)
    if not options.tilt_first:
        return fit
    return replace(fit, report={**fit.report, "effects": "held" if begin is start else "fitted first"})


def _knows_no_effect(start: Calibration) -> bool:
    effects = slice(start.model.n_geometric, None)
    some = len(start.names) > start.model.n_geometric
    return some and np.array_equal(start.values[effects], start.model.values0()[effects])


def _tilted(start: Calibration, measurement: Measurement, options: IdentifyOptions) -> Calibration:
    """The start with its effects fitted beside base and tool, the chain held."""
    model = start.model
    chain = model.names[6 : model.n_geometric - 6]
    fit = estimate(start, measurement, replace(options, tilt_first=False, method="least_squares", free=(), fix=chain))
    values = start.values.copy()
    values[model.n_geometric :] = fit.values[model.n_geometric :]
    return replace(start, values=values)
