"""Hand-eye calibration from flange poses alone: no joint angles, so nothing of the arm is fitted.

AX = ZB in closed form is the start, then all pixels are fitted at once. What the flange is off by is told by how views scatter
beyond their corners, and views count as far as an arm that is off so much lets them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.measurement.camera.rig_fit import estimate_start_rig, fit_rig_beside_arm, tool_errors
from kilter_core.measurement.camera.view_scatter import ViewScatter
from kilter_core.measurement.camera.views import Views, sight
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.observations.rig import Rig
from kilter_core.types import Floats, Ints


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
