"""Frames from digitised points, and hand-eye calibration from flange poses alone.

AX = ZB in closed form is the start, then all pixels are fitted at once. What the flange is off by is told by how views scatter
beyond their corners, and views count as far as an arm that is off so much lets them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.measurement.camera.rig_fit import estimate_start_rig, fit_rig_beside_arm, tool_errors
from kilter_core.measurement.camera.views import Views, ViewScatter, sight
from kilter_core.measurement.markers import FLAT, span_ratio
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.observations.rig import Rig
from kilter_core.parameters import mm
from kilter_core.transforms import nearest_rotation
from kilter_core.types import Floats, Ints

MIRRORED = 3.0  # a mirror image must fit so many times better
SMALLEST_M = 1e-9


@dataclass(frozen=True)
class ReferenceFrame:
    """Pose (4, 4) of the frame in the device's coordinates; what each point is off, (K,) m."""

    pose: Floats
    left: Floats

    @property
    def rms(self) -> float:
        """Root mean square of what the points are off, m."""
        return float(np.sqrt(np.mean(self.left**2)))


def frame_of_points(known: Floats, measured: Floats) -> ReferenceFrame:
    """Frame in which the points ``measured (K, 3)`` m have the coordinates ``known (K, 3)`` m, by least squares.

    Raises:
        ObservationError: ``points_collinear``, fewer than three points or all in one line; ``points_mirrored``.

    """
    _refuse_line(known, "known")
    _refuse_line(measured, "measured")
    k, m = known - known.mean(axis=0), measured - measured.mean(axis=0)
    R = nearest_rotation(m.T @ k)
    left = np.linalg.norm(m - k @ R.T, axis=1)
    other = -k if np.linalg.matrix_rank(k, tol=FLAT * np.linalg.norm(k)) == 3 else k
    mirrored = float(np.sqrt(np.mean((m - other @ nearest_rotation(m.T @ other).T) ** 2) * 3.0))
    rms = float(np.sqrt(np.mean(left**2)))
    if other is not k and rms > MIRRORED * mirrored + SMALLEST_M and rms > FLAT * np.linalg.norm(k):
        raise ObservationError(
            f"The measured points are the mirror image of the known ones ({mm(rms):.3g} mm off, mirrored "
            f"{mm(mirrored):.3g} mm): two coordinates are exchanged, or one has the other sign.",
            code="points_mirrored",
        )
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, measured.mean(axis=0) - R @ known.mean(axis=0)
    return ReferenceFrame(T, left)


def frame_of_features(plane: Floats, line: Floats, origin: Floats) -> ReferenceFrame:
    """Frame whose xy plane holds ``plane (K, 3)``, whose x axis runs along ``line (L, 3)`` from its first point to its last,
    and whose origin is below ``origin (3,)``; z is on the side from which the plane's points run anticlockwise.

    Raises:
        ObservationError: ``points_collinear``: fewer than three points of the plane, all in one line, or a line of no length.

    """
    _refuse_line(plane, "plane")
    middle = plane.mean(axis=0)
    normal = np.linalg.svd(plane - middle, full_matrices=False)[2][2]
    around = np.cross(plane - middle, np.roll(plane, -1, axis=0) - middle).sum(axis=0)
    z = normal if normal @ around >= 0.0 else -normal
    along = _along(line)
    x = along - z * (along @ z)
    size = float(np.linalg.norm(x))
    if size < FLAT:
        raise ObservationError(
            "The points of the line give no direction in the plane: digitise two points or more, well apart.",
            code="points_collinear",
        )
    x /= size
    T = np.eye(4)
    T[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    T[:3, 3] = origin - z * ((origin - middle) @ z)
    return ReferenceFrame(T, np.abs((plane - middle) @ z))


def _along(line: Floats) -> Floats:
    """Direction of a line, from its first point to its last; zero where it has none."""
    if len(line) < 2:
        return np.zeros(3)
    first = np.linalg.svd(line - line.mean(axis=0), full_matrices=False)[2][0]
    length = line[-1] - line[0]
    if np.linalg.norm(length) < SMALLEST_M:
        return np.zeros(3)
    return np.asarray(first if first @ length > 0 else -first)


def _refuse_line(points: Floats, what: str) -> None:
    if span_ratio(points) < FLAT:
        raise ObservationError(
            f"The {len(points)} {what} points lie in one line or are fewer than three: they make no frame. Digitise three or "
            "more that span an area.",
            code="points_collinear",
        )


@dataclass(frozen=True)
class HandEyeCalibration:
    """Cameras and boards where they fit: fixed ones in the robot's base, the others on the flange.

    ``closed_form`` is the start; ``covariance`` is that of the unknowns by noisy corners and an arm that is off by another
    amount in each view, ``left_px (N,)`` the rms of each view, and ``scatter`` says how far the flange is from where views
    have it, their noise taken off.
    """

    rig: PlacedRig
    closed_form: PlacedRig
    covariance: Floats
    left_px: Floats
    scatter: ViewScatter


def hand_eye(
    position: Floats,
    rotation: Floats,
    rig: Rig,
    pixels: Floats,
    camera: Ints | None = None,
    board: Ints | None = None,
    sigma: Floats | None = None,
) -> HandEyeCalibration:
    """Find cameras and boards from flange poses ``position (N, 3)`` m, ``rotation (N, 3, 3)`` and ``pixels (N, M, 2)``.

    ``camera`` and ``board (N,)`` are places in the ``rig``, the first of each when None; ``sigma (N, M, 2)`` px.

    Raises:
        ObservationError: ``no_view``, or ``hand_eye_undetermined``.

    """
    first = np.zeros(len(position), dtype=np.int64)
    views = Views(first if camera is None else camera, first if board is None else board, position, rotation)
    start = estimate_start_rig(rig, views, pixels)
    fitted = fit_rig_beside_arm(start, views, pixels, sigma)
    r = pixels - sight(fitted.rig, views, pixels.shape[1])
    scatter = tool_errors(fitted.rig, views, pixels, sigma).scatter(6.0 * (len(rig.cameras) + len(rig.boards)))
    with np.errstate(invalid="ignore", divide="ignore"):
        left = np.sqrt(np.nansum(r**2, axis=(1, 2)) / np.sum(~np.isnan(r), axis=(1, 2)))
    return HandEyeCalibration(fitted.rig, start, fitted.covariance, np.asarray(left), scatter)
