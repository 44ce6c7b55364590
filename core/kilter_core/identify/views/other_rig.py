"""Descriptions of another board or another camera: corners that do not lie as described, and intrinsics that are not theirs.

Corners lie as described, or not, whatever arm and camera do: a view leaves pixels or the half of its board. A camera with other
intrinsics leaves what an arm that is far off does, unless it may have those that its own views ask for.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.measurement.camera.board_poses import board_poses
from kilter_core.measurement.camera.pixels import Pixels
from kilter_core.measurement.camera.rig_fit import FittedRig, estimate_start_rig, fit_rig
from kilter_core.measurement.camera.views import Views, camera_board_pairs
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.rig import Camera, Rig
from kilter_core.types import Floats

MOST_VIEWS = 60  # of each camera and board
MISPLACED = 0.05  # of how far a view's corners spread, beyond which no lens bends them
EXPLAINED = 0.5  # of what is left with intrinsics as stated, below which others are the truth
ROUNDS = 3  # of intrinsics, each from where camera and board stand by those found before
ZOOMS = (1.0, 1.4, 2.0, 0.7, 0.5)  # of the focal lengths as stated, from which others are looked for
BROWN = 5  # numbers of the lens that a camera without any may have


def refuse_misplaced_corners(views: Pixels) -> None:
    """Refuse a board whose corners do not lie as it is described.

    Raises:
        ObservationError: ``corners_misplaced``.

    """
    cameras, boards = views.observations.camera, views.observations.board
    assert cameras is not None
    assert boards is not None
    for c, b in camera_board_pairs(cameras, boards):
        camera, board = views.rig.cameras[c], views.rig.boards[b]
        mine = np.flatnonzero((cameras == c) & (boards == b) & views.measured_row_mask())
        pixels = views.pixels[mine[:: max(1, -(-len(mine) // MOST_VIEWS))]][:, : len(board.corners)]
        rms = board_poses(camera, np.array(camera.values), board, pixels)[2]
        told = np.isfinite(rms)  # where no pose was found, nothing is known of the corners
        seen = pixels[told]
        if not len(seen):
            continue
        off, spread = float(np.median(rms[told])), float(np.median(np.sqrt(np.nanvar(seen, axis=1).sum(axis=1))))
        if off > MISPLACED * spread:
            far = f"{off:.3g} px" if off < spread else "as much as they spread"
            raise ObservationError(
                f"Corners that camera {camera.name!r} saw of board {board.name!r} do not lie as `corners_mm` says: wherever "
                f"the board stands they are off by {far} (median of {len(seen)} views, which spread over {spread:.3g} px). "
                "It is the description of another board, its columns and rows are swapped, or corners are numbered otherwise: "
                "give the corners in the order of u1_px, v1_px, ... as `kilter measure see` does.",
                code="corners_misplaced",
                camera=camera.name,
                board=board.name,
                off_px=min(off, spread),
                spread_px=spread,
            )


def refuse_other_camera(begin: Calibration, rows: Observations, rig: Rig, camera: int) -> None:
    """Refuse intrinsics of another camera, zoom or size, by ``rows`` of one camera and board that tell poses.

    Raises:
        ObservationError: ``intrinsics_differ``.

    """
    stated = rig.cameras[camera]
    assert rows.camera is not None
    assert rows.board is not None
    assert rows.pixels is not None
    if stated.intrinsics == "free":
        return
    found = begin.predict(rows)
    views = Views(rows.camera, rows.board, found.position, found.rotation)
    held = freed = _fit_rig_from_views(rig.with_fixed_parameters(), views, rows)
    for zoom in ZOOMS:
        freed = min(freed, _own_intrinsics(rig, camera, zoom, views, rows, held), key=lambda fit: fit.sigma_px)
    own = freed.rig.cameras[camera].values
    if freed.sigma_px > EXPLAINED * held.sigma_px or not _better_within(
        rows, rig, camera, _free_intrinsics(stated), own
    ):
        return
    fx, fy, cx, cy = own[:4]
    given = f"{stated.focal[0]:.4g}, {stated.focal[1]:.4g}; {stated.centre[0]:.4g}, {stated.centre[1]:.4g} px"
    raise ObservationError(
        f"With the intrinsics that its own views ask for (focal lengths {fx:.4g} and {fy:.4g} px, centre {cx:.4g}, "
        f"{cy:.4g} px) camera {stated.name!r} and the arm agree to {freed.sigma_px:.2g} px, with those stated ({given}, lens "
        f"{stated.model}) to {held.sigma_px:.2g} px: these are of another camera, zoom, focus or picture size. Find them anew "
        '(`kilter measure see --intrinsics brown`), or let the fit find them ("intrinsics": "free", with a lens).',
        code="intrinsics_differ",
        camera=stated.name,
        stated_px=held.sigma_px,
        own_px=freed.sigma_px,
    )


def _own_intrinsics(rig: Rig, place: int, zoom: float, views: Views, rows: Observations, held: FittedRig) -> FittedRig:
    """The best fit with intrinsics of a camera's own, begun with so much of the focal lengths as stated; else ``held``."""
    now, best = _free_intrinsics(rig.cameras[place]), held
    now = replace(now, focal=(zoom * now.focal[0], zoom * now.focal[1]))
    for _ in range(ROUNDS):
        try:
            found = _fit_rig_from_views(_replace_camera(rig.with_fixed_parameters(), place, now), views, rows)
        except ObservationError:  # no board stands before a camera so far off
            break
        best = min(best, found, key=lambda fit: fit.sigma_px)
        values = found.rig.cameras[place].values
        if not np.isfinite(values).all() or values[:2].min() <= 0.0:
            break
        now = replace(now, focal=(values[0], values[1]), centre=(values[2], values[3]), distortion=tuple(values[4:]))
    return best


def _better_within(rows: Observations, rig: Rig, place: int, freed: Camera, own: Floats) -> bool:
    """Whether boards by themselves fit better with a camera's ``own`` intrinsics: an arm that is far off bends them, too."""
    assert rows.board is not None
    assert rows.pixels is not None
    board, stated = rig.boards[int(rows.board[0])], rig.cameras[place]
    pixels = rows.pixels[:, : len(board.corners)]
    as_stated, as_own = (
        board_poses(camera, values, board, pixels)[2]
        for camera, values in ((stated, np.array(stated.values)), (freed, own))
    )
    return bool(np.nanmedian(as_own) < np.nanmedian(as_stated))


def _free_intrinsics(camera: Camera) -> Camera:
    """The camera with unknown intrinsics; one without a lens may have Brown's."""
    free = replace(camera, intrinsics="free", sigmas=None)
    return replace(free, model="brown", distortion=(0.0,) * BROWN) if camera.model == "none" else free


def _replace_camera(rig: Rig, place: int, camera: Camera) -> Rig:
    return replace(rig, cameras=tuple(camera if k == place else one for k, one in enumerate(rig.cameras)))


def _fit_rig_from_views(rig: Rig, views: Views, rows: Observations) -> FittedRig:
    assert rows.pixels is not None
    return fit_rig(estimate_start_rig(rig, views, rows.pixels), views, rows.pixels, rows.pixel_sigma)
