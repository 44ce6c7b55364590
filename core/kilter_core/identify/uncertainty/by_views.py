"""What an identification from pixels alone knows: of its parameters, of the tool where a camera sees it, and of its cameras.

Corners of one view share what the model gets wrong there, blur and a bent board
(:mod:`~kilter_core.identify.uncertainty.tool_error`). And views of one pose share what the model gets wrong of the arm there:
what each pose says counts as far as it differs from that by more than chance, as in
:mod:`~kilter_core.identify.uncertainty.clustered`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.identify.fit.least_squares import Fit, taken_by_group
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
from kilter_core.measurement.camera.view_scatter import ViewScatter
from kilter_core.model.placed_rig import PlacedRig, Unknown
from kilter_core.parameters import Parameter
from kilter_core.transforms import inverse, skew
from kilter_core.types import Floats


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
