"""Poses that determine a model best by what cameras see: greedy D-optimal choice by the derivatives of pixels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.arm.driving_order import driving_order, joint_ranges
from kilter_core.effects import Effect
from kilter_core.errors import ObservationError, RobotError
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.setup_frames import without_frames
from kilter_core.identify.views import Cameras, with_cameras
from kilter_core.measurement import Measurement
from kilter_core.measurement.camera.camera_model import project, undistort_pixels
from kilter_core.measurement.camera.pixels import Pixels
from kilter_core.model import Calibration, Prediction, RobotModel
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.model.region import Region
from kilter_core.observations import Observations
from kilter_core.observations.groups import with_neutral_conditions
from kilter_core.plan.d_optimal import POOL, conditions, looked_for, most_informative, with_loads
from kilter_core.transforms import inverse, inverses
from kilter_core.types import Bools, Floats, Ints

RIM = 0.02  # share of the picture left free at its edges
SLANTED = 0.5  # cosine between normal and line of sight below which corners blur into each other
FLAT = 1e-3  # of its size that a board may be thick
OUTWARD = 0.75  # the same of a corner of a solid and of the way to it from the middle: its surface is not known
FEWEST_CORNERS = 4
BACK = 1e-6  # how well a lens must lead back to the direction: far outside the picture it folds


@dataclass(frozen=True)
class Pair:
    """Camera ``c`` of a rig and board ``b``. ``side`` is 1 where the board's z points away from who reads it, else -1."""

    rig: PlacedRig
    c: int
    b: int
    side: float = 1.0

    @property
    def corners(self) -> Floats:
        """Corners (M, 3) m in the board's frame."""
        return self.rig.corners(self.b)

    def poses(self, tool: Prediction) -> tuple[Floats, Floats]:
        """Board in the camera's frame, (N, 3) m and (N, 3, 3)."""
        p, R = tool.position, tool.rotation
        if self.rig.rig.cameras[self.c].mount == "flange":
            p, R = inverses(p, R)
        X, Y = inverse(self.rig.cameras[self.c].pose), self.rig.boards[self.b].pose
        return (p + R @ Y[:3, 3]) @ X[:3, :3].T + X[:3, 3], X[:3, :3] @ R @ Y[:3, :3]

    def pixels(self, tool: Prediction) -> Floats:
        """Corners (N, M, 2) px; NaN those out of sight, and all where the board is not seen well."""
        p, R = self.poses(tool)
        out = np.full((len(p), len(self.corners), 2), np.nan)
        turned = self._facing_corners(p, R)
        some = np.flatnonzero(turned.sum(axis=1) >= min(FEWEST_CORNERS, len(self.corners)))
        points = self.corners @ R[some].transpose(0, 2, 1) + p[some, None]
        camera = self.rig.rig.cameras[self.c]
        near = (points[..., 2] > 0.0).all(axis=1)
        if camera.model != "fisheye":  # a lens bends less than by half
            wide = 1.5 * np.array(camera.size) / np.array(camera.focal)
            near &= (np.abs(points[..., :2]) <= wide * points[..., 2:]).all(axis=(1, 2))
        some, points = some[near], points[near]
        values = self.rig.cameras[self.c].values
        seen = project(camera.model, values, points).pixels
        rim = RIM * np.array(camera.size)
        inside = ((seen >= rim) & (seen <= np.array(camera.size) - 1 - rim)).all(axis=2)
        ok = (inside | ~turned[some]).all(axis=1)
        some, points, seen = some[ok], points[ok], seen[ok]
        back = undistort_pixels(camera.model, values, seen) - points[..., :2] / points[..., 2:]
        own = turned[some]
        good = (np.isfinite(back).all(axis=2) & (np.abs(back) < BACK).all(axis=2) | ~own).all(axis=1)
        out[some[good]] = np.where(own[good][..., None], seen[good], np.nan)
        return out

    def _facing_corners(self, p: Floats, R: Floats) -> Bools:
        """Corners (N, M) whose surface looks at the camera; of a solid those on the side towards it."""
        corners = self.corners
        middle = corners.mean(axis=0)
        _, s, axes = np.linalg.svd(corners - middle, full_matrices=False)
        towards = -(R @ middle + p)
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        if s[2] < FLAT * s[0]:
            normal = axes[2] if axes[2, 2] < 0.0 else -axes[2]
            facing = self.side * np.sum((R @ normal) * towards, axis=1) >= SLANTED
            return np.repeat(facing[:, None], len(corners), axis=1)
        outward = corners - middle
        outward = outward / np.linalg.norm(outward, axis=1, keepdims=True)
        return np.asarray(np.einsum("nij,mj,ni->nm", R, outward, towards) >= OUTWARD)


def pairs(rig: PlacedRig, driven: Prediction | None = None) -> tuple[Pair, ...]:
    """Every camera with the boards that move against it; which side of a board is printed, poses ``driven`` before tell."""
    found = [
        Pair(rig, c, b)
        for c, camera in enumerate(rig.rig.cameras)
        for b, board in enumerate(rig.rig.boards)
        if camera.mount != board.mount
    ]
    return tuple(one if driven is None else _choose_printed_side(one, driven) for one in found)


def _choose_printed_side(pair: Pair, driven: Prediction) -> Pair:
    sides = [Pair(pair.rig, pair.c, pair.b, side) for side in (1.0, -1.0)]
    front, back = (int((~np.isnan(one.pixels(driven)[..., 0])).any(axis=1).sum()) for one in sides)
    return sides[0] if front >= back else sides[1]


BATCH, BATCHES = 10_000, 40  # random poses tried for such that cameras see
SLICE = 50  # views whose derivatives are held at once
TOLD = 1e-9  # of the most that a view tells, below which a direction counts as not seen
FEWEST_DRIVEN = 5

Told = Callable[[float], None]


def placed_by_views(start: Calibration, rows: Observations | None) -> Calibration:
    """The start with cameras and boards where it has them, or where the views among ``rows`` say that they stand.

    Raises:
        ObservationError: ``cameras_missing`` where neither knows of a camera; what the views do not tell.

    """
    if rows is None or rows.pixels is None or rows.camera is None:
        if start.rig is None:
            raise ObservationError(
                "Poses are planned by views only where cameras and boards stand somewhere: name a version that was identified "
                "with them, or a campaign of views.",
                code="cameras_missing",
            )
        return start
    seen = replace(rows.select(rows.camera >= 0), position=None, rotation=None, markers=None, sigma=None)
    return without_frames(with_cameras(start, seen, Measurement.from_observations(seen, held=True)))


def view_poses(
    start: Calibration,
    count: int,
    effects: Sequence[Effect] = (),
    noise: float = 5e-5,
    seed: int = 0,
    progress: Told | None = None,
    region: Region | None = None,
    payloads_kg: Sequence[float] = (),
    payload_com: Sequence[float] = (),
    driven: Floats | None = None,
) -> Observations:
    """As :func:`kilter_core.plan.d_optimal.d_optimal_poses`, of views by the cameras of ``start``.

    At each pose a board is whole in a picture and faces its camera. ``noise`` is that of a corner, in m at the board;
    joints ``driven (N, n)`` before tell on which side a board is printed (else its z points away from the camera).

    Raises:
        ObservationError: ``cameras_missing``. RobotError: joint limits are missing, or cameras see hardly a pose.

    """
    rng, told = np.random.default_rng(seed), progress or (lambda fraction: None)
    start = placed_by_views(start, None)
    model, values, free = _looked_for(start, effects)
    needs = model.needs
    assert start.rig is not None
    before = (
        None
        if driven is None or len(driven) < FEWEST_DRIVEN
        else _bare(start).predict(_observations_from_joints(driven))
    )
    looking = pairs(start.rig, before)
    q = _seen_joints(_bare(start), region or Region.from_calibration(start), looking, count, rng, told)
    pool = with_loads(conditions(q, needs, payloads_kg, rng), needs, start.robot, payload_com)
    H = _information(model, values, free, with_neutral_conditions(pool, needs), looking, _bare(start))
    sigma = np.array([model.parameters[k].prior_sigma for k in free]) / noise
    chosen = pool.select(most_informative(_roots(H * np.outer(sigma, sigma)), count, told))
    return chosen.select(driving_order(chosen.q, joint_ranges(start.robot)))


def _bare(start: Calibration) -> Calibration:
    """The arm without effects, which look for columns that random poses lack; they move it by millimetres."""
    return start.with_effects(())


def _observations_from_joints(q: Floats) -> Observations:
    return Observations(np.asarray(q, dtype=np.float64))


def _looked_for(start: Calibration, effects: Sequence[Effect]) -> tuple[RobotModel, Floats, Ints]:
    """The model with the effects it lacks and its cameras, its values, and what an identification by views would free."""
    assert start.rig is not None
    rig = start.rig.with_folded_increments()
    whole, values, _ = looked_for(start, effects)
    whole = replace(whole, effects=(*whole.effects, Cameras(rig=rig)))
    free = IdentifyOptions(tool="fixed").free_parameters(whole, observes_orientation=True, observes_base=False)
    return whole, np.concatenate([values, rig.values]), free


def _seen_joints(
    arm: Calibration, region: Region, looking: Sequence[Pair], count: int, rng: np.random.Generator, told: Told
) -> Floats:
    """Joint vectors (K, n), ``count`` or more, at which a camera sees a board well."""
    wanted, found, tried = max(POOL, 3 * count), np.zeros((0, arm.robot.n_joints)), 0
    for _ in range(BATCHES):
        told(0.0)
        q = region.draw(BATCH, rng)
        tried += len(q)
        tool = arm.predict(_observations_from_joints(q))
        seen = np.any([(~np.isnan(pair.pixels(tool)[..., 0])).any(axis=1) for pair in looking], axis=0)
        found = np.concatenate([found, q[seen]])
        if len(found) >= wanted:
            return found[:wanted]
    if len(found) >= count:
        return found
    raise RobotError(
        f"Of {tried} random poses only {len(found)} have a board whole in a picture and facing its camera, {count} are "
        "needed: give more room or fewer poses, or move camera or board so that more poses are seen.",
        field="joints",
    )


def _information(
    model: RobotModel, values: Floats, free: Ints, pool: Observations, looking: Sequence[Pair], arm: Calibration
) -> Floats:
    """Information (N, P, P) per m² of noise in what all cameras see at each pose."""
    rig = looking[0].rig.rig
    tool, H = arm.predict(_observations_from_joints(pool.q)), np.zeros((len(pool), len(free), len(free)))
    for pair in looking:
        pixels = np.full((len(pool), rig.most_corners, 2), np.nan)
        pixels[:, : len(pair.corners)] = pair.pixels(tool)
        which = np.flatnonzero(~np.isnan(pixels).all(axis=(1, 2)))
        if not len(which):
            continue
        views = replace(
            pool.select(which),
            pixels=pixels[which],
            camera=np.full(len(which), pair.c),
            board=np.full(len(which), pair.b),
            rig=rig,
        )
        metres_per_px = _pixels(views).metres_per_px
        for part in range(0, len(which), SLICE):
            some = np.arange(part, min(part + SLICE, len(which)))
            H[which[some]] += _of_views(model, values, free, views.select(some), metres_per_px)
    return H


def _of_views(model: RobotModel, values: Floats, free: Ints, views: Observations, metres_per_px: float) -> Floats:
    """Information (n, P, P) in views, by the Jacobian that a fit of them has."""
    seen = _pixels(views)
    [block] = seen.blocks(*model.jacobian(views, values, free))
    assert block.J is not None
    A = (metres_per_px / seen.metres_per_px * block.J * ~np.isnan(seen.pixels)[..., None]).reshape(
        len(views), -1, len(free)
    )
    return np.asarray(A.transpose(0, 2, 1) @ A)


def _pixels(views: Observations) -> Pixels:
    found = Measurement.from_observations(views, held=True).pixels
    assert found is not None
    return found


def _roots(H: Floats) -> Floats:
    """Rows X (N, r, P) with XᵀX = H: r is what a view tells, six numbers of a pose and those of lens and scale."""
    w, V = np.linalg.eigh(H)
    r = int((w > TOLD * w[:, -1:].max()).sum(axis=1).max())
    return np.asarray(np.sqrt(np.maximum(w[:, -r:], 0.0))[:, :, None] * V[:, :, -r:].transpose(0, 2, 1))
