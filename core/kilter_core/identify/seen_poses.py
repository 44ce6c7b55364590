"""Views as poses of the tool: for what compares whole visits, and asks of each row where the tool was.

The pose of each board before its camera, carried through camera and board as a version has them, or as an identification of
the geometry finds them, says where the tool was in the robot's base; its corners say how well along each axis.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from kilter_core.errors import FindingDocument, ObservationError
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.run import identify
from kilter_core.identify.view_report import WRONG_VIEWS
from kilter_core.identify.views import PlannedViews
from kilter_core.measurement import Measurement
from kilter_core.measurement.camera.board_poses import board_poses
from kilter_core.measurement.poses import DEVIATIONS, typical_deviations, weights
from kilter_core.model import Calibration
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.observations import Observations
from kilter_core.observations.rig import CONTACTS
from kilter_core.transforms import inverse, inverses
from kilter_core.types import Bools, Floats

FEWEST_OF_TRACKER = 30  # poses, below which geometry alone leaves little of a tracker's rows to search
BARE: dict[str, Any] = dict.fromkeys(("pixels", "pixel_sigma", "camera", "board", "rig", *CONTACTS))
OF_TRACKER: dict[str, Any] = dict.fromkeys(("markers", "tip"))


def seen_poses(
    begin: Calibration, rows: Observations, *others: Any
) -> tuple[tuple[Any, ...], PlannedViews | None, tuple[FindingDocument, ...]]:
    """The rows, and others that are rows, with a pose of the tool for every view; as they are where none has pixels only.

    Beside a tracker of :data:`FEWEST_OF_TRACKER` poses, or of as many as the views, the tracker's rows tell, and pixels are
    left out. Fewer of them, and rows that a contact held, tell of the geometry, the cameras and the scale of the boards, and
    are left out after it. Nests of a pose are taken together. Where views tell, also how well others would, and
    warnings of views that are wrong.

    Raises:
        ObservationError: views that tell no pose.

    """
    if rows.pixels is None:
        return tuple(one.whole_poses() if isinstance(one, Observations) else one for one in (rows, *others)), None, ()
    if _tracker_tells(rows):
        return (
            tuple(replace(one, **BARE) if isinstance(one, Observations) else one for one in (rows, *others)),
            None,
            (),
        )
    assert rows.rig is not None
    known = begin
    said: tuple[FindingDocument, ...] = ()
    if begin.rig is None or not begin.rig.has(rows.rig):
        result = identify(begin.robot, rows, None, IdentifyOptions(loss="huber", effects=()), begin)
        known, said = result.calibration, tuple(one for one in result.warnings if one["code"] in WRONG_VIEWS)
    seen, covariance, found = _poses_from_views(known, rows)
    scale = typical_deviations(covariance)
    made: list[Any] = [replace(seen, pose_weight=weights(covariance, scale))]
    for one in others:
        if isinstance(one, Observations) and one.pixels is not None:
            more, covariance, _ = _poses_from_views(known, one)
            one = replace(more, pose_weight=weights(covariance, scale))
        made.append(one)
    return tuple(made), PlannedViews.from_measured_views(known, *found, scale), said


def _tracker_tells(rows: Observations) -> bool:
    """Whether a tracker measured the tool, beside views, in so many poses that a search takes its rows."""
    if rows.position is None and rows.markers is None:
        return False
    seen = [
        np.isfinite(one).reshape(len(rows), -1).any(axis=1) for one in (rows.position, rows.markers) if one is not None
    ]
    assert rows.camera is not None
    of_tracker, of_views = (len(np.unique(rows.pose_groups()[own])) for own in (np.any(seen, axis=0), rows.camera >= 0))
    return of_tracker >= min(FEWEST_OF_TRACKER, of_views)


def as_seen_places(calibration: Calibration, rows: Observations, noise: float | None = None) -> Observations:
    """Views as poses of the tool by the cameras of a version, weighed so that their errors are numbers of deviations.

    With a ``noise`` (m) that is stated for each coordinate they are places, and nothing else of them counts.

    Rows that have no pixels alone are as they are.

    Raises:
        ObservationError: ``camera_unknown``, a camera or board that the version was not made with.

    """
    if rows.pixels is None or rows.position is not None or rows.markers is not None:
        return rows
    assert rows.rig is not None
    if calibration.rig is None or not calibration.rig.has(rows.rig):
        named = ", ".join([*(c.name for c in rows.rig.cameras), *(b.name for b in rows.rig.boards)])
        raise ObservationError(
            f"The version was not made with all of {named}: only a camera and a board that stand where they stood show whether "
            "the arm has moved. Check against a version that was identified with them.",
            code="camera_unknown",
        )
    seen, covariance, _ = _poses_from_views(calibration, rows)
    if noise is not None:
        return replace(seen, sigma=None, rotation=None)
    return replace(seen, sigma=None, pose_weight=weights(covariance, DEVIATIONS))


def _poses_from_views(
    known: Calibration, rows: Observations
) -> tuple[Observations, Floats, tuple[PlacedRig, Observations, float]]:
    """Rows with the poses of the tool that their views show, and the covariance (N, 6, 6) of each, m and rad; the rig, the
    views themselves, and the standard deviation of a corner, px.
    """
    views = Measurement.from_observations(rows, held=True).pixels
    assert views is not None
    errors = views.tool_errors(known)
    scatter = errors.scatter()
    prediction = known.predict(rows)
    rig = views.resolve_rig(prediction)
    n = len(rows)
    p, R, told = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan), np.zeros(n, dtype=bool)
    for which, c, b in views.views(prediction).pairs():
        p[which], R[which], told[which] = _poses(rig, (c, b), views.pixels[which])
    sigma = np.full((n, 3), np.nan)
    deviations = np.sqrt(np.diagonal(errors.covariance, axis1=1, axis2=2)[:, :3])
    sigma[errors.rows] = scatter.sigma_px * deviations
    kept = told & ~np.isnan(sigma).any(axis=1)
    if not kept.any():
        raise ObservationError("No view tells a pose: measure views that show more of a board.", code="no_view")
    covariance = np.full((n, 6, 6), np.nan)
    covariance[errors.rows] = scatter.sigma_px**2 * errors.covariance
    found = replace(rows, position=p, rotation=R, sigma=sigma, **BARE, **OF_TRACKER).select(kept)
    return found, covariance[kept], (rig, rows.select(kept), scatter.sigma_px)


def _poses(rig: PlacedRig, pair: tuple[int, int], pixels: Floats) -> tuple[Floats, Floats, Bools]:
    """Tool poses (n, 3) and (n, 3, 3) of views of one camera and board, and which tell one."""
    c, b = pair
    camera, board, lens, sheet = rig.rig.cameras[c], rig.rig.boards[b], rig.cameras[c], rig.boards[b]
    grown = rig.corners(b)
    real = replace(board, corners=tuple(map(tuple, grown.tolist())))
    p, R, _, told = board_poses(camera, lens.values, real, pixels[:, : len(grown)])
    fixed = camera.mount == "fixed"
    M = np.tile(np.eye(4), (len(p), 1, 1))
    M[:, :3, 3], M[:, :3, :3] = (p, R) if fixed else inverses(p, R)
    room, tool = (lens, sheet) if fixed else (sheet, lens)
    T = room.pose @ M @ inverse(tool.pose)
    return T[:, :3, 3], T[:, :3, :3], told
