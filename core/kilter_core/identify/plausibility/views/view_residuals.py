"""What a fit leaves of each view, as a motion of the tool, and how that follows the parameters and a camera that moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.views.cameras import rig_from_calibration
from kilter_core.measurement.camera.views import equivalent_tool_motions
from kilter_core.observations.rig import Board, Camera
from kilter_core.types import Floats, Ints

NUMBERS = 6  # that a view tells of the tool
SEEN = 1e-10  # share of a direction that is left beside the parameters, below which it is theirs


@dataclass(frozen=True)
class Part:
    """A camera or a board that stands somewhere, in words, and how views (K, 6, 6) follow its increments, whitened."""

    words: str
    name: str
    camera: bool
    fixed: bool
    columns: Floats


@dataclass(frozen=True)
class ViewResiduals:
    """Views ``rows (K,)`` of those fitted: motions ``r (K, 6)`` that are left, in deviations of their corners; how they follow
    the parameters ``A (K, 6, F)``, in prior sigmas; and the parts of the rig. ``place (K, 3, 6)`` m takes whitened motions
    back to where the tool is.
    """

    rows: Ints
    r: Floats
    A: Floats
    place: Floats
    parts: tuple[Part, ...]

    @staticmethod
    def from_fit(fit: Fit) -> ViewResiduals | None:
        """Of a fit to views alone; None where something else tells of the tool, or no view tells a pose."""
        problem, views = fit.problem, fit.problem.measurement.pixels
        rig = rig_from_calibration(fit.calibration())
        if views is None or rig is None or not problem.measurement.tool.places_itself:
            return None
        told = views.tool_errors(fit.calibration())
        if not len(told.rows):
            return None
        prediction, J = problem.model.jacobian(
            problem.batch, fit.values, problem.free, problem.measurement.needs_turns, problem.measurement.reads_joints
        )
        carried, inner = (
            equivalent_tool_motions(views.resolve_rig(prediction), views.views(prediction)),
            J[:, :6].copy(),
        )
        assert prediction.instrument is not None
        columns = prediction.instrument.columns
        fitted = np.flatnonzero(columns >= 0)
        inner[:, :, columns[fitted]] += carried[:, :, fitted]
        root = np.linalg.cholesky(np.linalg.inv(told.covariance)).transpose(0, 2, 1) / told.sigma_px
        white = (root @ told.motion[:, :, None])[:, :, 0]
        unknowns = views.resolve_rig(prediction).unknowns
        parts = []
        described: tuple[tuple[bool, Sequence[Camera | Board]], ...] = (
            (True, views.rig.cameras),
            (False, views.rig.boards),
        )
        for camera, each in described:
            for k, one in enumerate(each):
                own = [i for i, (u, _) in enumerate(unknowns) if (u.camera, u.place, u.what) == (camera, k, "pose")]
                words = f"{'Camera' if camera else 'Board'} {one.name}"
                parts.append(Part(words, one.name, camera, one.mount == "fixed", root @ carried[told.rows][:, :, own]))
        A = root @ inner[told.rows] * problem.prior_sigma
        place = np.asarray(np.linalg.inv(root)[:, :3], dtype=np.float64)
        return ViewResiduals(told.rows, white, A, place, tuple(parts))

    def only(self, keep: Ints) -> ViewResiduals:
        """Some of the views."""
        parts = tuple(replace(p, columns=p.columns[keep]) for p in self.parts)
        return ViewResiduals(self.rows[keep], self.r[keep], self.A[keep], self.place[keep], parts)

    @cached_property
    def freedom(self) -> float:
        """Numbers beyond those that the parameters took, one prior sigma of each being known."""
        s = np.linalg.svd(self.A.reshape(-1, self.A.shape[2]), compute_uv=False)
        return float(max(self.r.size - np.sum(s**2 / (s**2 + 1.0)), 1.0))

    @cached_property
    def parameter_covariance(self) -> Floats:
        """Inverse (F, F) of the information of the parameters, with their priors."""
        flat = self.A.reshape(-1, self.A.shape[2])
        return np.asarray(np.linalg.inv(flat.T @ flat + np.eye(flat.shape[1])))

    @cached_property
    def refitted_residuals(self) -> Floats:
        """What is left (K, 6) where the parameters may follow anew."""
        step = self.parameter_covariance @ np.einsum("kif,ki->f", self.A, self.r)
        return np.asarray(self.r - self.A @ step)
