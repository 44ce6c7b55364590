"""Cameras and boards beside an arm that is held as it is: views count as far as the arm is known.

All corners of a view share what the arm is off by there. Taken for independent they would hold a shift of the camera with a
rotation that undoes it in the picture by hundredths of a pixel, and the arm's millimetre moves the two at will. So each view
has a motion of the tool of its own beside its corners, as wide as the views scatter: generalised least squares, with widths as
:mod:`~kilter_core.measurement.camera.view_scatter` finds them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.identify.fit.least_squares import Fit, fit_at
from kilter_core.identify.uncertainty.by_views import view_scatter
from kilter_core.identify.uncertainty.clustered import as_normal
from kilter_core.identify.views.cameras import rig_at, unknown_rig
from kilter_core.measurement import Block
from kilter_core.measurement.camera.view_scatter import SMALLEST_M, SMALLEST_RAD, ViewScatter
from kilter_core.measurement.camera.views import sight_and_slopes
from kilter_core.types import Floats

ROUNDS = 8  # of finding what the arm is off by and fitting again
SETTLED = 1e-6  # prior sigmas


def holds_arm(fit: Fit) -> bool:
    """Whether views are all that was fitted of the tool, and cameras and boards all that was free."""
    problem, rig = fit.problem, unknown_rig(fit.problem.model)
    alone = problem.measurement.tool.places_itself and len(problem.measurement.kinds) == 1
    if rig is None or not alone or problem.held is not None:
        return False
    return set(fit.names) <= {parameter.name for parameter in rig.parameters}


def beside_held_arm(fit: Fit) -> Fit:
    """The fit with what the arm is off by in each view as a part of its model; as it is where the arm was fitted too."""
    if not holds_arm(fit):
        return fit
    for _ in range(ROUNDS):
        H, downhill = _equations(fit, view_scatter(fit))
        step: Floats = np.asarray(np.linalg.solve(H, downhill), dtype=np.float64)
        values = fit.problem.moved(fit.values, step)
        fit = replace(fit_at(fit.problem, values, fit.problem.linearised(values), fit.iterations), report=fit.report)
        if float(np.max(np.abs(step), initial=0.0)) < SETTLED:
            break
    return fit


def by_held_arm(fit: Fit, found: ViewScatter) -> Fit:
    """The same with the covariance of its parameters, scaled so that 1.96 sigma are half of Student's 95 % interval."""
    around = np.linalg.inv(_equations(fit, found)[0])
    scale = as_normal(fit.problem.prior_sigma, found.freedom)
    return replace(fit, covariance=np.asarray(around * np.outer(scale, scale)), freedom=found.freedom)


def _equations(fit: Fit, found: ViewScatter) -> tuple[Floats, Floats]:
    """Normal equations (F, F), (F,) in prior sigmas, the priors included, of views whose tool is off as was found."""
    problem, views = fit.problem.wholly(), fit.problem.measurement.pixels
    rig = rig_at(problem.model, fit.values)
    assert views is not None
    assert rig is not None
    here = problem.linearised(fit.values)
    A, r = problem.by_row(here)
    seen = views.views(problem.model.predict(problem.batch, fit.values))
    by_tool = sight_and_slopes(rig, seen, views.pixels.shape[1])[1].by_tool
    by_tool = np.broadcast_to(views.weights, views.pixels.shape)[..., None] * np.nan_to_num(by_tool)
    (block,), (root,) = here.residual.blocks, problem.roots(here.residual)
    white = problem.over_sigma_slope(Block(block.group, block.r, by_tool))
    B = (white if root is None else root[..., None] * white).reshape(len(A), -1, 6)
    taken = float(np.mean(problem.weights.points)) / views.metres_per_px
    variance = (found.sigma_px / taken) ** 2  # of a whitened number, by its corner alone
    wide = [max(found.place, SMALLEST_M) ** -2.0] * 3 + [max(found.turn, SMALLEST_RAD) ** -2.0] * 3
    B_T = B.transpose(0, 2, 1)
    shared = np.linalg.solve(variance * np.diag(wide) + B_T @ B, B_T)
    told = A.transpose(0, 2, 1) - (A.transpose(0, 2, 1) @ B) @ shared
    prior = problem.prior
    away = prior.stiff(prior.away(problem.current(fit.values)))
    H = np.einsum("nkr,nrl->kl", told, A) / variance + problem.prior_information()
    return H, np.asarray(np.einsum("nkr,nr->k", told, r) / variance - away)
