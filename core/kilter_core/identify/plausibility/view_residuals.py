"""What a fit leaves of each view, as a motion of the tool, and how that follows the parameters and a camera that moved.

Views whose joints are not theirs, or whose corners are wrong, stand out when all others are fitted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import gammaincinv

from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.views import rig_from_calibration
from kilter_core.measurement.camera.views import equivalent_tool_motions
from kilter_core.observations.rig import Board, Camera
from kilter_core.parameters import mm
from kilter_core.types import Bools, Floats, Ints

NUMBERS = 6  # that a view tells of the tool
SEEN = 1e-10  # share of a direction that is left beside the parameters, below which it is theirs
FAR = 25.0  # times the usual square of what is left, five deviations, beyond which a view does not count
MOST = 0.25  # share of the views above which it is not known which are wrong
PASSES = 12
LISTED = 20


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
        described: dict[bool, Sequence[Camera | Board]] = {True: views.rig.cameras, False: views.rig.boards}
        for camera, each in described.items():
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


def astray(seen: ViewResiduals) -> Bools:
    """Views (K,) that are far from where the others put the tool; none where too many are."""
    far = np.zeros(len(seen.rows), dtype=bool)
    weight = np.ones(len(far))
    for _ in range(PASSES):  # a few wrong ones have moved the fit: those that stand out are first weighed down
        square = np.sum(_refitted_residuals(seen, weight) ** 2, axis=1) / NUMBERS
        weight = 1.0 / (1.0 + square / max(float(np.median(square)), 1e-300)) ** 2
    for _ in range(PASSES):
        square = np.sum(_refitted_residuals(seen, weight) ** 2, axis=1) / NUMBERS
        usual = float(np.median(square[~far])) * NUMBERS / float(2.0 * gammaincinv(NUMBERS / 2.0, 0.5))
        now = square > FAR * usual
        if now.mean() > MOST:
            return np.zeros(len(far), dtype=bool)
        if np.array_equal(now, far) and np.array_equal(weight, ~far):
            break
        far, weight = now, np.asarray(~now, dtype=np.float64)
    return far


def _refitted_residuals(seen: ViewResiduals, weight: Floats | Bools) -> Floats:
    """What is left (K, 6) of all views where the parameters follow those of some ``weight (K,)``."""
    A = seen.A.reshape(-1, seen.A.shape[2])
    weighed = A * np.repeat(np.asarray(weight, dtype=np.float64), NUMBERS)[:, None]
    step = np.linalg.solve(weighed.T @ A + np.eye(A.shape[1]), weighed.T @ seen.r.reshape(-1))
    return np.asarray(seen.r - seen.A @ step)


def sizes(seen: ViewResiduals, used: Bools) -> Floats:
    """How far (K,) m each view is from where those ``used`` put the tool."""
    left = (seen.place @ _refitted_residuals(seen, used)[:, :, None])[:, :, 0]
    return np.asarray(np.linalg.norm(left, axis=1))


def astray_views(seen: ViewResiduals, far: Bools, numbers: Ints) -> Iterator[dict[str, Any]]:
    """The warning ``views_astray``; ``numbers (N,)`` are those of the fitted rows among the ones given, from 0."""
    if not far.any():
        return
    size = mm(sizes(seen, ~far))
    rows, off_mm = (numbers[seen.rows[far]] + 1).tolist(), size[far].tolist()
    yield {
        "code": "views_astray",
        "rows": rows,
        "off_mm": off_mm,
        "message": f"Rows {rows_off(rows, off_mm)} are far from where the others put the tool, which are off by "
        f"{float(np.median(size[~far])):.2g} mm (median): joints of another picture, an arm that moved, or corners that are "
        "wrong. Look at these pictures, correct their joints or leave these rows out, and identify again.",
    }


def rows_off(rows: Sequence[int], off_mm: Sequence[float]) -> str:
    """The first of some rows, each with how far off it is, and how many more there are."""
    listed = ", ".join(f"{row} ({one:.3g} mm)" for row, one in list(zip(rows, off_mm, strict=True))[:LISTED])
    return listed if len(rows) <= LISTED else f"{listed} and {len(rows) - LISTED} more"
