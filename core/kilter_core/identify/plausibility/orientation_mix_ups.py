"""Orientation that is given in another convention than it is read in, where the positions fit.

What a fit leaves of each view, as a motion of the tool, and how that follows the parameters and a camera that moved.

Views whose joints are not theirs, or whose corners are wrong, stand out when all others are fitted.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations
from typing import Literal

import numpy as np
from scipy.special import gammaincinv

from kilter_core.errors import FindingDocument
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.plausibility.mix_ups import mix_ups
from kilter_core.identify.plausibility.set_up_changes import Sample
from kilter_core.identify.views import rig_from_calibration
from kilter_core.measurement.camera.views import equivalent_tool_motions
from kilter_core.observations.rig import Board, Camera
from kilter_core.parameters import degrees, mm
from kilter_core.transforms import nearest_rotation, rotation_log, scipy_rotation
from kilter_core.types import Bools, Floats, Ints

NEAR_RAD = np.radians(5.0)  # scatter of the tool's rotation on the flange that real arms stay below
FACTOR = 5.0
RIGHT_RAD = np.radians(3.0)
POSITION = 1.5  # times the residual of the positions that another reading of the joints may leave
Angles = Literal["ZXZ", "ZYX", "XYZ", "ZYZ", "xyz", "zyx"]
EULER: dict[Angles, str] = {
    "ZXZ": "ZXZ (phi, theta, psi)",
    "ZYX": "ZYX",
    "XYZ": "XYZ",
    "ZYZ": "ZYZ",
    "xyz": "roll, pitch, yaw (fixed X, Y, Z)",
    "zyx": "fixed Z, Y, X",
}

Accusation = tuple[tuple[str, ...], tuple[str, ...], float, float]


@dataclass(frozen=True)
class Reading:
    """Another way to read the rotations: one or two variants (V, K, 3, 3) per row, of which each row may take either."""

    sentence: str
    remedy: str
    flange: Floats  # rotations (K, 3, 3) of the flange in the frame of the measurements
    variants: Floats


def rotation_faults(sample: Sample, stated: bool) -> tuple[Accusation | None, tuple[FindingDocument, ...]]:
    """What is wrong with the rotations where positions fit; ``stated``: by angles or quaternions, not seen by markers.

    Returns an accusation (sentences, remedies, degrees left before and after) or None, and warnings.
    """
    assert sample.rotations is not None
    flange = sample.fitted_placement.rotation @ sample.flange[:, :3, :3]
    before, tool = scatter(flange, sample.rotations[None])
    if before <= NEAR_RAD:
        return None, _right_angle(sample, tool) if stated else ()
    readings = [*_of_joints(sample), *(_of_rotations(sample, flange) if stated else ())]
    if not readings:
        return None, ()
    sizes = [scatter(r.flange, r.variants)[0] for r in readings]
    best = min(sizes)
    if best * FACTOR > before or best > NEAR_RAD:
        return None, ()
    alike = [r for r, size in zip(readings, sizes, strict=True) if size < 1.5 * best + 1e-6]
    return (
        tuple(dict.fromkeys(r.sentence for r in alike)),
        tuple(dict.fromkeys(r.remedy for r in alike)),
        float(degrees(before)),
        float(degrees(best)),
    ), ()


def scatter(flange: Floats, variants: Floats) -> tuple[float, Floats]:
    """Scatter (rad, the median of rows) of the tool's rotation on the flange, and that rotation (3, 3)."""
    rotations = flange.transpose(0, 2, 1) @ variants
    best, tool = np.inf, np.eye(3)
    for row in range(0, rotations.shape[1], max(1, rotations.shape[1] // 8)):
        for reference in rotations[:, row]:
            angle = _angles(reference, rotations).min(axis=0)
            if np.median(angle) < best:
                best, tool = float(np.median(angle)), reference
    near = _angles(tool, rotations)
    chosen = np.take_along_axis(rotations, near.argmin(axis=0)[None, :, None, None], axis=0)[0]
    tool = nearest_rotation(chosen[near.min(axis=0) <= np.quantile(near.min(axis=0), 0.7)].mean(axis=0))
    return float(np.median(_angles(tool, rotations).min(axis=0))), tool


def _angles(reference: Floats, rotations: Floats) -> Floats:
    """Angle of each rotation (..., 3, 3) against one."""
    trace = np.einsum("ij,...ij->...", reference, rotations)
    return np.asarray(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))


def _of_joints(sample: Sample) -> Iterator[Reading]:
    """Mix-ups of joints that the positions do not see, as of those behind the last bend."""
    limit = POSITION * sample.fitted_placement.size + 1e-4
    for m in mix_ups(sample.begin.robot):
        if m.length != 1.0 or m.mirror or m.inverted or m.offset is not None:
            continue
        read = sample.undo_mix_up(m)
        if read.fitted_placement.size <= limit and read.rotations is not None:
            yield Reading(
                m.sentence, m.remedy, read.fitted_placement.rotation @ read.flange[:, :3, :3], read.rotations[None]
            )


def _of_rotations(sample: Sample, flange: Floats) -> Iterator[Reading]:
    assert sample.rotations is not None
    rotations = sample.rotations
    what = "name the columns, or the convention in the column map, as they are, and upload again"
    yield Reading(
        "The orientation looks transposed (tool to base given as base to tool)",
        "invert the rotations",
        flange,
        rotations.transpose(0, 2, 1)[None],
    )
    wxyz = scipy_rotation().from_matrix(rotations).as_quat()[:, [3, 0, 1, 2]]
    for order in permutations(range(4)):
        if order != (0, 1, 2, 3):
            meant = "".join("wxyz"[order.index(k)] for k in range(4))
            again = scipy_rotation().from_quat(wxyz[:, order][:, [1, 2, 3, 0]]).as_matrix()
            yield Reading(f"The quaternion looks to be in the order {meant}, read as wxyz", what, flange, again[None])
    for read, meant, variants in _of_angles(rotations):
        yield Reading(f"The angles look to be {EULER[meant]}, read as {EULER[read]}", what, flange, variants)
    yield from _other_axes(rotations, flange)


def _of_angles(rotations: Floats) -> Iterator[tuple[Angles, Angles, Floats]]:
    parsed = scipy_rotation().from_matrix(rotations)
    for read in EULER:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # at gimbal lock any of the angles do
            angles = parsed.as_euler(read)
        middle = -angles[:, 1] if read[0] == read[2] else np.pi - angles[:, 1]
        other = np.stack([angles[:, 0] + np.pi, middle, angles[:, 2] + np.pi], axis=1)
        for meant in EULER:
            if meant != read:
                both = [scipy_rotation().from_euler(meant, a).as_matrix() for a in (angles, other)]
                yield read, meant, np.stack(both)


def _other_axes(rotations: Floats, flange: Floats) -> Iterator[Reading]:
    """Rotations given about other axes than the positions: the rotation between both, from pairs of rows (Procrustes)."""
    step = np.roll(np.arange(len(rotations)), -max(1, len(rotations) // 3))
    seen = rotation_log(rotations[step] @ rotations.transpose(0, 2, 1))
    moved = rotation_log(flange[step] @ flange.transpose(0, 2, 1))
    axes = nearest_rotation(seen.T @ moved)
    about = rotation_log(axes[None])[0]
    angle = float(np.linalg.norm(about))
    if angle > np.radians(30.0):
        axis = np.round(about / angle, 2) + 0.0
        named = _axis(about)
        yield Reading(
            f"The orientation looks to be given about other axes than the positions, rotated by "
            f"{degrees(angle):.0f} degrees about {named or axis.tolist()}",
            "give positions and orientations in one frame",
            flange,
            (axes.T @ rotations)[None],
        )


def _right_angle(sample: Sample, tool: Floats) -> tuple[FindingDocument, ...]:
    """Warn of a tool that is rotated against the robot's by a right angle about one of its axes."""
    about = rotation_log((sample.begin.robot.T_tool[:3, :3].T @ tool)[None])[0]
    angle = float(np.linalg.norm(about))
    nearest = round(angle / (np.pi / 2.0))
    axis = _axis(about)
    if nearest == 0 or not axis or abs(angle - nearest * np.pi / 2.0) > RIGHT_RAD:
        return ()
    return (
        FindingDocument.make(
            "orientation_right_angle",
            f"Positions fit, and the measured orientation is rotated by {90 * nearest} degrees about the "
            f"tool's {axis} axis against the robot's tool. If that is not how the target "
            "sits, correct the tool of the robot or the axes of the orientation; a free tool takes it up.",
            axis=axis,
            angle_deg=90 * nearest,
        ),
    )


def _axis(about: Floats) -> str:
    """Name of the axis, with its sign, that a rotation is about; empty when it is about none."""
    size = float(np.linalg.norm(about))
    k = int(np.argmax(np.abs(about)))
    off = float(np.linalg.norm(np.delete(about, k))) / max(size, 1e-12)
    return ("-" if about[k] < 0 else "") + "xyz"[k] if off < np.sin(RIGHT_RAD) else ""


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


def astray_views(seen: ViewResiduals, far: Bools, numbers: Ints) -> Iterator[FindingDocument]:
    """The warning ``views_astray``; ``numbers (N,)`` are those of the fitted rows among the ones given, from 0."""
    if not far.any():
        return
    size = mm(sizes(seen, ~far))
    rows, off_mm = (numbers[seen.rows[far]] + 1).tolist(), size[far].tolist()
    yield FindingDocument.make(
        "views_astray",
        f"Rows {rows_off(rows, off_mm)} are far from where the others put the tool, which are off by "
        f"{float(np.median(size[~far])):.2g} mm (median): joints of another picture, an arm that moved, or corners that are "
        "wrong. Look at these pictures, correct their joints or leave these rows out, and identify again.",
        rows=rows,
        off_mm=off_mm,
    )


def rows_off(rows: Sequence[int], off_mm: Sequence[float]) -> str:
    """The first of some rows, each with how far off it is, and how many more there are."""
    listed = ", ".join(f"{row} ({one:.3g} mm)" for row, one in list(zip(rows, off_mm, strict=True))[:LISTED])
    return listed if len(rows) <= LISTED else f"{listed} and {len(rows) - LISTED} more"
