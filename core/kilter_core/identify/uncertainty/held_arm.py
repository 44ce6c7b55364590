"""Cameras and boards beside an arm that is held as it is: views count as far as the arm is known.

All corners of a view share what the arm is off by there. Taken for independent they would hold a shift of the camera with a
rotation that undoes it in the picture by hundredths of a pixel, and the arm's millimetre moves the two at will. So each view
has a motion of the tool of its own beside its corners, as wide as the views scatter: generalised least squares, with widths as
:mod:`~kilter_core.measurement.camera.view_scatter` finds them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.identify.fit.least_squares import Fit, build_fit
from kilter_core.identify.uncertainty.by_views import by_poses, view_scatter
from kilter_core.identify.uncertainty.clustered import products
from kilter_core.identify.views.cameras import rig_from_values, unknown_rig
from kilter_core.measurement import Block
from kilter_core.measurement.camera.view_scatter import SMALLEST_M, SMALLEST_RAD, ViewScatter
from kilter_core.measurement.camera.views import sight_by_tool
from kilter_core.types import Floats

ROUNDS = 8  # of finding what the arm is off by and fitting again
SETTLED = 1e-6  # prior sigmas


def holds_arm(fit: Fit) -> bool:
    """Whether views are all that was fitted of the tool, and cameras and boards all that was free."""
    problem, rig = fit.problem, unknown_rig(fit.problem.model)
    alone = problem.measurement.tool.places_itself and len(problem.measurement.kinds) == 1
    if rig is None or not alone:
        return False
    return set(fit.names) <= {parameter.name for parameter in rig.parameters}


def beside_held_arm(fit: Fit) -> Fit:
    """The fit with what the arm is off by in each view as a part of its model; as it is where the arm was fitted too.

    What was held was blind beside corners as far off as the arm made them. A free lens was bent then, and not told again.
    """
    if not holds_arm(fit):
        return fit
    problem = fit.problem if fit.problem.held is None else fit.problem.with_weights(fit.problem.weights, None)
    for _ in range(ROUNDS):
        A, r = _whiten_with_tool_error(fit, view_scatter(fit))
        away = problem.prior.stiff(problem.prior.standardized_deviation(problem.current(fit.values)))
        downhill = np.einsum("nrk,nr->k", A, r) - away
        step: Floats = np.asarray(
            np.linalg.solve(products(A, A) + problem.prior_information(), downhill), dtype=np.float64
        )
        values = problem.apply_step(fit.values, step)
        fit = replace(build_fit(problem, values, problem.linearise(values), fit.iterations), report=fit.report)
        if float(np.max(np.abs(step), initial=0.0)) < SETTLED:
            break
    return fit


def by_held_arm(fit: Fit, found: ViewScatter) -> Fit:
    """The same with the covariance of its parameters, scaled so that 1.96 sigma are half of Student's 95 % interval.

    Views of one pose share what the arm is off by there: what each pose says counts as in
    :mod:`~kilter_core.identify.uncertainty.clustered`.
    """
    return by_poses(fit, *_whiten_with_tool_error(fit, found), found)


def _whiten_with_tool_error(fit: Fit, found: ViewScatter) -> tuple[Floats, Floats]:
    """Jacobian (N, R, F) in prior sigmas and residuals (N, R), by corners and a tool that is off as was found."""
    problem, views = fit.problem.wholly(), fit.problem.measurement.pixels
    rig = rig_from_values(problem.model, fit.values)
    assert views is not None
    assert rig is not None
    here = problem.linearise(fit.values)
    A, r = problem.by_row(here)
    seen = views.views(problem.model.predict(problem.batch, fit.values))
    by_tool = sight_by_tool(rig, seen, views.pixels.shape[1])[1]
    by_tool = np.broadcast_to(views.weights, views.pixels.shape)[..., None] * np.nan_to_num(by_tool)
    (block,), (root,) = here.residual.blocks, problem.roots(here.residual)
    white = problem.over_sigma_slope(Block(block.group, block.r, by_tool))
    B = (white if root is None else root[..., None] * white).reshape(len(A), -1, 6)
    corner = found.sigma_px * views.metres_per_px / float(np.mean(problem.weights.points))  # of a whitened number
    wide = np.array([max(found.place, SMALLEST_M)] * 3 + [max(found.turn, SMALLEST_RAD)] * 3)
    along, size, _ = np.linalg.svd(B * wide / corner, full_matrices=False)
    less = 1.0 - 1.0 / np.sqrt(1.0 + size**2)  # of what is along the motions of the tool, beside what corners say

    def apply_whitening(x: Floats) -> Floats:
        return np.asarray((x - along @ (less[:, :, None] * (along.transpose(0, 2, 1) @ x))) / corner)

    return apply_whitening(A), apply_whitening(r[:, :, None])[:, :, 0]
