"""What a fit by views alone knows: of its parameters, of the tool where a camera sees it, of the zeros of a table.

All corners of a view share what the arm is off by there. Taken for independent they would hold a shift of the camera with a
rotation that undoes it in the picture by hundredths of a pixel, and the arm's millimetre moves the two at will: zeros fitted
beside constants that were off left 8.4 mm of new views where frames alone left 3.7. So each view has a motion of the tool of
its own beside its corners, as wide as the views scatter: generalised least squares, with widths as
:mod:`~kilter_core.measurement.camera.views` finds them.

Corners of one view share what the model gets wrong there, blur and a bent board
(:mod:`~kilter_core.identify.uncertainty.by_view`). And views of one pose share what the model gets wrong of the arm there:
what each pose says counts as far as it differs from that by more than chance, as in
:mod:`~kilter_core.identify.uncertainty.clustered`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kilter_core.identify.fit.least_squares import Fit, build_fit, taken_by_group
from kilter_core.identify.options import FRAME_NAMES
from kilter_core.identify.uncertainty.clustered import (
    as_normal,
    products,
    sandwich,
    scores_by_pose,
    shrink_score_covariance,
)
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.identify.views import rig_from_values, unknown_rig
from kilter_core.measurement import Block
from kilter_core.measurement.camera.views import SMALLEST_M, SMALLEST_RAD, ViewScatter, sight_by_tool
from kilter_core.model import Calibration
from kilter_core.model.placed_rig import PlacedRig, Unknown
from kilter_core.model.table_fit import ClosestTable, zero_names
from kilter_core.parameters import Parameter
from kilter_core.transforms import inverse, skew
from kilter_core.types import QUANTILE, Bools, Floats

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


def view_scatter(fit: Fit) -> ViewScatter:
    """How far off the tool is in the views that were fitted, corrected for what the fit took from them."""
    views = fit.problem.measurement.pixels
    assert views is not None
    inner = sum(unknown.what != "pose" for unknown, _ in _unknowns(fit))
    return views.tool_errors(fit.calibration()).scatter(fit.effective - inner, inner)


def tool_sigma_from_views(fit: Fit) -> float | None:
    """Standard deviation (m) of a coordinate of the tool by views beside a tracker; None where no view tells.

    Corners say how noisy a view is, whatever a model lacks. So views say how far off the tool is where a tracker's points, each
    pose visited once, cannot tell that from their noise.
    """
    views = fit.problem.measurement.pixels
    if views is None or views.observes_tool:
        return None
    errors = views.tool_errors(fit.calibration())
    inner = sum(unknown.what != "pose" for unknown, _ in _unknowns(fit))
    if not len(errors.rows) or errors.numbers <= inner:
        return None
    return errors.scatter(max(taken_by_group(fit)[views.group] - inner, 0.0), inner).place


def by_poses(fit: Fit, A: Floats, r: Floats, found: ViewScatter) -> Fit:
    """The fit with the covariance that poses support, of whitened views ``A (N, R, F)`` and ``r (N, R)``."""
    problem = fit.problem
    total, known = products(A, A), problem.prior_information()
    bread = np.asarray(np.linalg.inv(total + known), dtype=np.float64)
    poses = scores_by_pose(A, r, problem.measurement.observations.pose_groups(), bread)
    around = sandwich(total + known, shrink_score_covariance(total, *poses), known, known)
    scale = as_normal(problem.prior_sigma, found.freedom)
    return replace(fit, covariance=around * np.outer(scale, scale), freedom=found.freedom)


def predictive_of_views(fit: Fit, found: ViewScatter) -> Predictive:
    """What is known of the tool as cameras see it: where the first camera and board stand counts as base and tool do.

    That the tool is rotated beyond what the model explains counts where views scatter by more than chance: the likeliest width
    of something that is not there is above 0, and tilts of views are so noisy that it would hide a part of every change.
    """
    rig, views = rig_from_values(fit.problem.model, fit.values), fit.problem.measurement.pixels
    assert rig is not None
    assert views is not None
    seen, frames = {p.name for _, p in _unknowns(fit)}, _frames(rig, fit)
    arm = [name not in seen for name in fit.names]
    M = np.concatenate([np.eye(len(fit.names))[arm], *(block for _, block in frames)])
    names = [*np.array(fit.names)[arm].tolist(), *(f"{frame}_{k}" for frame, _ in frames for k in FRAME_NAMES)]
    noise = found.sigma_px * views.metres_per_px
    turn = found.turn if found.exceeds_noise else 0.0
    return Predictive(tuple(names), M @ fit.covariance @ M.T, found.place, noise, found.freedom, views.name, turn)


def _frames(rig: PlacedRig, fit: Fit) -> list[tuple[str, Floats]]:
    """How base and tool (6, F) follow the places of the first camera and board that the rows have, as cameras see the arm.

    ``rig`` has the increments that were fitted: a first camera's place is 0.1 rad off, and the covariance is of these. What is
    known of d_6 and of the board only together would else be a hundredth of a prior, which is more than pixels leave.
    """
    views = fit.problem.measurement.observations
    assert views.camera is not None
    assert views.board is not None
    first = int(np.flatnonzero(views.camera >= 0)[0])
    camera, board = int(views.camera[first]), int(views.board[first])
    outside = rig.rig.cameras[camera].mount == "fixed"
    places = {True: (True, camera), False: (False, board)}
    room, tool = (places[True], places[False]) if outside else (places[False], places[True])
    ball = any(name.startswith("tool_") for name in fit.names)  # told by contacts, and a parameter like any other
    T = inverse(fit.calibration().model.T_base)
    at = {key: (rig.cameras if key[0] else rig.boards)[key[1]] for key in (room, tool)}
    base = ("base", -_adjoint(T @ at[room].pose) @ at[room].twist @ _pose_increment_rows(fit, *room))
    flange = ("tool", _adjoint(at[tool].pose) @ at[tool].twist @ _pose_increment_rows(fit, *tool))
    return [base] if ball else [base, flange]


def _pose_increment_rows(fit: Fit, camera: bool, place: int) -> Floats:
    """Rows (6, F) that pick the increments of a part; zero where they were not fitted."""
    out = np.zeros((6, len(fit.names)))
    for unknown, parameter in _unknowns(fit):
        if (unknown.camera, unknown.place, unknown.what) == (camera, place, "pose") and parameter.name in fit.names:
            out[unknown.index, fit.names.index(parameter.name)] = 1.0
    return out


def _unknowns(fit: Fit) -> tuple[tuple[Unknown, Parameter], ...]:
    rig = unknown_rig(fit.problem.model)
    assert rig is not None
    return rig.unknowns


def _adjoint(T: Floats) -> Floats:
    """Takes a twist (v, w) in a frame into the frame in which it stands at T (4, 4)."""
    R = T[:3, :3]
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = R
    out[:3, 3:] = skew(T[None, :3, 3])[0] @ R
    return out


def rig_sigmas(fit: Fit) -> dict[str, float]:
    """Standard deviations of what was fitted of cameras and boards, SI and px."""
    names = {p.name for _, p in _unknowns(fit)}
    return {name: float(s) for name, s in zip(fit.names, fit.sigma, strict=True) if name in names}


class KnownZeros(NamedTuple):
    """Half widths (n,) of the 95 % intervals of joints' zeros, rad (m of a prismatic joint).

    ``held (n,)``: the joint's own zero was not identified, by convention or because nobody asked for it, or it shares with
    the base or the tool what it is, so that an interval says nothing of it.
    """

    half_width: Floats
    held: Bools


def known_zeros(calibration: Calibration, table: ClosestTable, known: Predictive) -> KnownZeros | None:
    """Propagate a version's covariance to the zeros of its closest table, to first order.

    A zero of the table is not the parameter of that name alone: links whose lengths are not known either rotate it, which a
    covariance of all of them has. Parameters that were not identified count as exact. None where the table has rows of
    another form than the nominal ones, whose zeros then mean something else.
    """
    if table.zeros is None:
        return None
    J = table.zeros.derivatives(calibration, known.names)
    variance = np.einsum("jp,pq,jq->j", J, known.covariance, J)
    own = zero_names(calibration.robot)
    held = np.array([name in calibration.names and name not in known.names for name in own], dtype=bool)
    return KnownZeros(QUANTILE * np.sqrt(np.maximum(variance, 0.0)), held | ~table.zeros.identifiable_zeros())
