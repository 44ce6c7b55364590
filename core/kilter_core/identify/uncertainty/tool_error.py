"""A fit by views, no instrument beside them: each view counts as far as the model of the arm is known to hold there.

All corners of a view share what the arm is off by there. Taken for independent they would hold a shift of the camera with a
rotation that undoes it in the picture by hundredths of a pixel, and the arm's millimetre moves the two at will: zeros fitted
beside constants that were off left 8.4 mm of new views where frames alone left 3.7. So each view has a motion of the tool of
its own beside its corners, as wide as the views scatter: generalised least squares, with widths as
:mod:`~kilter_core.measurement.camera.view_scatter` finds them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.identify.fit.least_squares import Fit, build_fit
from kilter_core.identify.uncertainty.by_views import by_poses, view_scatter
from kilter_core.identify.uncertainty.clustered import products
from kilter_core.identify.views import rig_from_values, unknown_rig
from kilter_core.measurement import Block
from kilter_core.measurement.camera.view_scatter import SMALLEST_M, SMALLEST_RAD, ViewScatter
from kilter_core.measurement.camera.views import sight_by_tool
from kilter_core.types import Floats

ROUNDS = 8  # of finding what the arm is off by and fitting again
SETTLED = 1e-6  # prior sigmas


def beside_tool_error(fit: Fit) -> Fit:
    """The fit with what the arm is off by in each view as a part of its model.

    As it is where an instrument measured too, and where views scatter as their corners do. What was held was blind beside
    corners as far off as the arm made them. A free lens was bent then, and not told again.
    """
    by_views = fit.problem.measurement.tool.places_itself and unknown_rig(fit.problem.model) is not None
    if not by_views or not view_scatter(fit).exceeds_noise:
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


def by_tool_error(fit: Fit, found: ViewScatter) -> Fit:
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
    sizes = [one.r[0].size for one in here.residual.blocks]
    own = next(k for k, one in enumerate(here.residual.blocks) if one.group == views.group)
    block, root = here.residual.blocks[own], problem.roots(here.residual)[own]
    corners = slice(sum(sizes[:own]), sum(sizes[: own + 1]))
    white = problem.over_sigma_slope(Block(block.group, block.r, by_tool))
    B = (white if root is None else root[..., None] * white).reshape(len(A), -1, 6)
    corner = found.sigma_px * views.metres_per_px / float(np.mean(problem.weights.points))  # of a whitened number
    wide = np.array([max(found.place, SMALLEST_M)] * 3 + [max(found.turn, SMALLEST_RAD)] * 3)
    along, size, _ = np.linalg.svd(B * wide / corner, full_matrices=False)
    # Of what is along the motions of the tool, beside what corners say.
    less = found.exceeds_noise * (1.0 - 1.0 / np.sqrt(1.0 + size**2))

    def apply_whitening(x: Floats) -> Floats:
        seen = x[:, corners]
        seen = (seen - along @ (less[:, :, None] * (along.transpose(0, 2, 1) @ seen))) / corner
        return np.concatenate([x[:, : corners.start], seen, x[:, corners.stop :]], axis=1)

    return apply_whitening(A), apply_whitening(r[:, :, None])[:, :, 0]
