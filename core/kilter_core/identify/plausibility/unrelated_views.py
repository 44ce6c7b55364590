"""Whether views belong to their joint readings: against shuffled rows and reversed joints, by hand-eye alone.

A hand-eye calibration of the nominal arm leaves millimetres. Rows whose joints belong to other pictures leave what any
shuffled rows do, and a joint that is read with the other sign leaves far more than it does reversed. A board that is not as
large as it is stated leaves more the farther the arm moves.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.errors import FindingDocument, ObservationError
from kilter_core.identify.plausibility.orientation_mix_ups import rows_off
from kilter_core.measurement import Measurement
from kilter_core.measurement.camera.board_poses import board_poses
from kilter_core.measurement.camera.pixels import Pixels
from kilter_core.measurement.camera.rig_fit import FittedRig, HandEye, estimate_start_rig, fit_rig, grown, solve_axzb
from kilter_core.measurement.camera.views import Views, camera_board_pairs, sight
from kilter_core.model import Calibration
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.observations import Observations
from kilter_core.observations.rig import Camera, Rig
from kilter_core.parameters import mm
from kilter_core.transforms import inverses
from kilter_core.types import QUANTILE, Bools, Floats, Ints

MOST_VIEWS = 60
FEWEST_VIEWS = 8
SHUFFLES = 5
UNRELATED = 0.5  # of what shuffled rows leave, beyond which the rows say no more than those
BETTER = 0.4  # of what the rows leave as given, below which a reversed joint is the truth
AS_GOOD = 1.25  # times that: then nothing tells the senses apart
ARM_M = 0.3  # what a radian left is worth
FAR = 10.0  # times what a view usually leaves, beyond which it is not of its joints,
AS_SHUFFLED = 0.1  # if that is this share of what shuffled rows leave too; where one is,
BESIDE = 0.03  # this share is enough for others: joints of another picture may be near one's own
MOST_FAR = 0.25  # share of the views above which it is not known which are wrong
SCALE = 0.01  # by which a board is larger or smaller, from which it is said before anything is fitted,
EXPLAINED = 0.5  # if what is left without it is this share at most of what is left
CLEAR = 5.0  # standard deviations
ODD = 0.005  # of what shuffled rows leave, from which it is asked whether intrinsics are of another camera

MOST_RIG_VIEWS = 60  # of each camera and board
MISPLACED = 0.05  # of how far a view's corners spread, beyond which no lens bends them
EXPLAINED_BY_RIG = 0.5  # of what is left with intrinsics as stated, below which others are the truth
ROUNDS = 3  # of intrinsics, each from where camera and board stand by those found before
ZOOMS = (1.0, 1.4, 2.0, 0.7, 0.5)  # of the focal lengths as stated, from which others are looked for
BROWN = 5  # numbers of the lens that a camera without any may have


@dataclass(frozen=True)
class _Sample:
    """Views that tell a pose, of one camera and one board."""

    begin: Calibration
    rows: Observations
    position: Floats
    rotation: Floats
    views: Pixels
    camera: int
    board: int

    def residual_with_shuffled_joints(self) -> float:
        """What hand-eye leaves (m, median of some shuffles) with joints of other rows; inf where it tells nothing."""
        rng, q = np.random.default_rng(0), self.rows.q
        left = np.array([self.hand_eye_residual(q[rng.permutation(len(q))]) for _ in range(SHUFFLES)])
        return float(np.median(left[np.isfinite(left)])) if np.isfinite(left).any() else np.inf

    def hand_eye_residual(self, q: Floats) -> float:
        """What hand-eye leaves (m, median) with these joint readings; inf where it tells nothing."""
        solved = self.solve_hand_eye(q)
        return np.inf if solved is None else float(np.median(solved.left_m) + ARM_M * np.median(solved.left_rad))

    def solve_hand_eye(self, q: Floats) -> HandEye | None:
        """Hand-eye with these joint readings; None where it tells nothing."""
        found = self.begin.predict(replace(self.rows, q=q))
        try:
            return solve_axzb(found.position, found.rotation, self.position, self.rotation)
        except ObservationError:
            return None


def refuse_unrelated_views(begin: Calibration, rows: Observations) -> tuple[FindingDocument, ...]:
    """Refuse views whose joints are of other pictures or read the other way round, and another board or camera than is
    described; warn of senses that fit as well.

    Raises:
        ObservationError: ``corners_misplaced``, ``foreign_observations``, ``intrinsics_differ``, ``views_astray`` or
            ``board_scale_differs``.

    """
    views = Measurement.from_observations(rows, begin.marker_points, held=True).pixels
    if views is not None:
        refuse_misplaced_corners(views)
    sample = _sample(begin, rows)
    if sample is None:
        return ()
    q = sample.rows.q
    given = sample.hand_eye_residual(q)
    shuffled = sample.residual_with_shuffled_joints()
    if not np.isfinite([given, shuffled]).all():
        return ()
    reversed_ = {j: sample.hand_eye_residual(np.where(np.arange(q.shape[1]) == j, -q, q)) for j in range(q.shape[1])}
    best = min(reversed_, key=lambda j: (reversed_[j], j))
    name = begin.robot.joints[best].name
    if reversed_[best] < BETTER * given and reversed_[best] < UNRELATED * shuffled:
        raise ObservationError(
            f"With the readings of joint {name} reversed, camera and arm agree to {mm(reversed_[best]):.3g} mm, as given to "
            f"{mm(given):.3g} mm: it seems to be read with the opposite sign. Reverse its column, or correct the robot.",
            code="foreign_observations",
            joint=name,
        )
    if given > UNRELATED * shuffled:
        raise ObservationError(
            f"Camera and arm agree to {mm(given):.3g} mm, shuffled rows to {mm(shuffled):.3g} mm: the joint readings do "
            "not belong to the pictures. Join them by their times again; check that robot, mounts and board are right.",
            code="foreign_observations",
            shuffled_mm=mm(shuffled),
        )
    assert rows.camera is not None
    for c in np.unique(rows.camera[rows.camera >= 0]):
        of = sample if c == sample.camera else _sample(begin, rows.select(np.flatnonzero(rows.camera == c)))
        if of is not None and of.hand_eye_residual(of.rows.q) > ODD * shuffled:
            refuse_other_camera(begin, of.rows, of.views.rig, int(c))
    _refuse_far(far_views(begin, rows), given)
    _refuse_scale(sample)
    return tuple(_mirrored_sense_warnings(sample, reversed_, given))


def far_views(begin: Calibration, rows: Observations) -> list[tuple[int, float]]:
    """Rows, from 0, whose pictures show the tool far from where their joints have the nominal arm, and how far, m.

    None where more than :data:`MOST_FAR` of the views are: then it is not known which are right.
    """
    sample = _sample(begin, rows)
    solved = None if sample is None else sample.solve_hand_eye(sample.rows.q)
    if sample is None or solved is None:
        return []
    views, c, b = sample.views, sample.camera, sample.board
    mine = _of_pair(rows, views, c, b)
    fixed = views.rig.cameras[c].mount == "fixed"
    room, tool = solved.world_side, solved.tool_side
    rig = PlacedRig.at_poses(views.rig, {c: room if fixed else tool}, {b: tool if fixed else room})
    found, codes = begin.predict(rows.select(mine)), np.ones(len(mine), dtype=np.int64)
    seen = sight(rig, Views(c * codes, b * codes, found.position, found.rotation), views.pixels.shape[1])
    told = ~np.isnan(views.pixels[mine])
    off = np.where(told, np.nan_to_num(views.pixels[mine] - seen, nan=np.inf), 0.0)
    size = views.metres_per_px * np.sqrt(np.sum(off**2, axis=(1, 2)) / told.sum(axis=(1, 2)))
    beyond, shuffled = size > FAR * float(np.median(size)), sample.residual_with_shuffled_joints()
    far = beyond & (size > BESIDE * shuffled)
    if not np.any(beyond & (size > AS_SHUFFLED * shuffled)) or far.mean() > MOST_FAR:
        return []
    own = mine[far]
    p, _, usable = _poses(views, c, b, own)
    there = begin.predict(rows.select(own))
    left = there.position + there.rotation @ tool[:3, 3] - p @ room[:3, :3].T - room[:3, 3]
    return list(zip(own.tolist(), np.where(usable, np.linalg.norm(left, axis=1), np.nan).tolist(), strict=True))


def _refuse_far(far: list[tuple[int, float]], given: float) -> None:
    if not far:
        return
    rows, off_mm = [row + 1 for row, _ in far], [mm(off) for _, off in far]
    raise ObservationError(
        f"Rows {rows_off(rows, off_mm)}: the board is that far from where their joints would have it, in the others "
        f"{mm(given):.2g} mm (median). Their joints are of other pictures. Join these rows with the joints of their own poses, "
        "or leave them out.",
        code="views_astray",
        rows=rows,
        off_mm=off_mm,
    )


def _refuse_scale(sample: _Sample) -> None:
    """Refuse a board of which another size explains most of what hand-eye leaves."""
    found = sample.begin.predict(sample.rows)
    solved = sample.solve_hand_eye(sample.rows.q)
    if solved is None:
        return
    by, sigma, left = grown(found.position, found.rotation, sample.position, solved)
    before = float(np.median(solved.left_m))
    if abs(by - 1.0) < max(SCALE, CLEAR * sigma) or left > EXPLAINED * before:
        return
    name, size = sample.views.rig.boards[sample.board].name, 1e2 * (by - 1.0)
    raise ObservationError(
        scale_sentence(name, size, 1e2 * QUANTILE * sigma)
        + f" With that camera and arm agree to {mm(left):.2g} mm, as stated to {mm(before):.2g} mm.",
        code="board_scale_differs",
        board=name,
        larger_percent=size,
        u95_percent=1e2 * QUANTILE * sigma,
    )


def scale_sentence(board: str, percent: float, half: float) -> str:
    """Say that a board is not as large as it is stated, or the arm not as it is described."""
    which = "larger" if percent > 0.0 else "smaller"
    return (
        f"The sheet of board {board} is {abs(percent):.2g} % {which} than stated (95 %: within {half:.1g} %), if the robot's "
        "lengths are as described. Measure its ruler with callipers: 100 mm on it would be "
        f"{100.0 + percent:.4g} mm. If they are, give the corners as they are (`corners_mm` times "
        f"{1.0 + 1e-2 * percent:.4g}), or print it at 100 %; if the ruler is right, the robot is described in another size."
    )


def shuffled_control(begin: Calibration, rows: Observations) -> dict[str, float | None]:
    """The negative control of views: what hand-eye leaves with the joints as given, and with those of other rows.

    Both are None where too few views tell a pose, or hand-eye finds nothing.
    """
    sample = _sample(begin, rows)
    if sample is None:
        return {"given_mm": None, "shuffled_mm": None}
    left = sample.hand_eye_residual(sample.rows.q), sample.residual_with_shuffled_joints()
    given, shuffled = (mm(one) if np.isfinite(one) else None for one in left)
    return {"given_mm": given, "shuffled_mm": shuffled}


def _mirrored_sense_warnings(sample: _Sample, reversed_: dict[int, float], given: float) -> Iterator[FindingDocument]:
    """Say which joints fit as well reversed: no view tells in which sense they move."""
    for j, left in reversed_.items():
        if left < AS_GOOD * given and np.ptp(sample.rows.q[:, j]) > 0.1:
            name = sample.begin.robot.joints[j].name
            yield FindingDocument.make(
                "mirrored_sense",
                f"Joint {name} fits these pictures as well with the opposite sense: camera and board would stand "
                "elsewhere. Add views in which further joints move, or move that joint alone and see which way the board goes.",
                joint=name,
            )


def _sample(begin: Calibration, rows: Observations) -> _Sample | None:
    views = Measurement.from_observations(rows, begin.marker_points, held=True).pixels
    if views is None or rows.camera is None or rows.board is None:
        return None
    pairs = np.stack([rows.camera, rows.board], axis=1)
    seen = pairs[(rows.camera >= 0) & views.measured_row_mask()]
    if not len(seen):
        return None
    kinds, count = np.unique(seen, axis=0, return_counts=True)
    c, b = (int(k) for k in kinds[int(np.argmax(count))])
    which = _of_pair(rows, views, c, b)
    which = which[:: max(1, -(-len(which) // MOST_VIEWS))]
    p, R, usable = _poses(views, c, b, which)
    if usable.sum() < FEWEST_VIEWS:
        return None
    return _Sample(begin, rows.select(which[usable]), p[usable], R[usable], views, c, b)


def _of_pair(rows: Observations, views: Pixels, c: int, b: int) -> Ints:
    return np.flatnonzero((rows.camera == c) & (rows.board == b) & views.measured_row_mask())


def _poses(views: Pixels, c: int, b: int, which: Ints) -> tuple[Floats, Floats, Bools]:
    """What moves with the tool, in the axes of what stands in the room, of views ``which``; and which of them tell it."""
    camera, board = views.rig.cameras[c], views.rig.boards[b]
    p, R, _, usable = board_poses(camera, np.array(camera.values), board, views.pixels[which][:, : len(board.corners)])
    if camera.mount == "flange":
        p, R = inverses(p, R)
    return p, R, usable


# Descriptions of another board or another camera: corners that do not lie as described, and intrinsics that are not
# theirs.
# Corners lie as described, or not, whatever arm and camera do: a view leaves pixels or the half of its board. A
# camera with other intrinsics leaves what an arm that is far off does, unless it may have those that its own views
# ask for.


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
        pixels = views.pixels[mine[:: max(1, -(-len(mine) // MOST_RIG_VIEWS))]][:, : len(board.corners)]
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
    if freed.sigma_px > EXPLAINED_BY_RIG * held.sigma_px or not _better_within(
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
