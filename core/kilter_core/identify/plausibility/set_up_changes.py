"""A few rows placed by base and tool alone, and campaigns whose tool or base was another one.

Beside the model's own parameters, linear about the fit of all campaigns together, every campaign after the first gets a
tool, a base, or both. What these take from what is left says whether the arm, or how it was set up, differed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.special import fdtrc

from kilter_core.arm.robot import Robot
from kilter_core.errors import CoreError
from kilter_core.identify.fit.problem import linearised_residual
from kilter_core.identify.plausibility.mix_ups import ELSEWHERE, MixUp, wire_units
from kilter_core.measurement import Measurement
from kilter_core.measurement.frames import best_frames
from kilter_core.measurement.kind import POINTS
from kilter_core.measurement.markers import fit_poses
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.groups import evenly
from kilter_core.types import Bools, Floats, Ints

CLEARLY = 2.5  # times less that must be left with a set-up for each campaign: loads and drift of an arm take less
ALIKE = 1.2  # times what base and tool together leave, up to which one of them explains it
CHANCE = 1e-9  # of as much from campaigns of one set-up
MOST_ROWS = 4000  # of all campaigns together that are looked at
MOST_PARTS = 20  # campaigns or sessions: of more the frames would be as many as the rows
FEWEST_ROWS = 6  # of a campaign, or it says nothing
SMALL = 1e-8  # singular values below that share of the largest move nothing
SETTLES = ("tool",), ("base",), ("base", "tool")


@dataclass(frozen=True)
class SetUpChange:
    """Frames ``which`` that each campaign has of its own, m that they lie apart, and m left with one for all and with each."""

    which: tuple[str, ...]
    moved: float
    together: float
    apart: float


def set_up_change(calibration: Calibration, parts: Sequence[Observations]) -> SetUpChange | None:
    """Return the frames that differ between the ``parts`` that a calibration was fitted to; None where one does for all."""
    seen = [part.select(part.tool_seen) for part in parts if part.position is not None or part.markers is not None]
    rows = [part for part in seen if len(part) >= FEWEST_ROWS]
    if not 2 <= len(rows) <= MOST_PARTS:
        return None
    rows = [part.select(evenly(len(part), MOST_ROWS // len(rows))) for part in rows]
    try:
        joined = Observations.concatenate([replace(part, pose_id=None) for part in rows])
        return _find_set_up_change(calibration, joined, np.repeat(np.arange(len(rows)), list(map(len, rows))))
    except (CoreError, np.linalg.LinAlgError):  # rows that differ in what was measured, or lack what an effect reads
        return None


def _find_set_up_change(calibration: Calibration, rows: Observations, part: Ints) -> SetUpChange | None:
    model, values = calibration.model.absorb_frame_increments(calibration.values)
    measurement = Measurement.from_observations(rows, calibration.marker_points, held=True).of_tool()
    free = np.arange(len(model.names))
    residual = linearised_residual(model, measurement, model.batch(measurement.observations), values, free)
    block = next((one for one in residual.blocks if one.group == POINTS), None)
    if block is None or block.J is None:
        return None
    r, J = block.r, block.J * np.array([p.prior_sigma for p in model.parameters])
    code = np.broadcast_to(part[:, None, None], r.shape)
    seen = ~np.isnan(r)
    r, J, code = r[seen], J[seen], code[seen]
    n = model.n_geometric
    frames = {"base": np.arange(6), "tool": np.arange(n - 6, n if rows.markers is not None else n - 3)}
    sigma = {name: np.array([model.parameters[k].prior_sigma for k in index]) for name, index in frames.items()}
    Q = _basis(J)
    plain = r - Q @ (Q.T @ r)
    before, codes = float(plain @ plain), range(1, int(part.max()) + 1)
    fits = {}
    for which in SETTLES:
        columns = np.hstack([J[:, frames[name]] * (code == c)[:, None] for c in codes for name in which])
        free_of = columns - Q @ (Q.T @ columns)
        found = np.linalg.lstsq(free_of, plain, rcond=SMALL)[0]
        left = plain - free_of @ found
        fits[which] = float(left @ left), found, int(np.linalg.matrix_rank(free_of, tol=SMALL * np.sqrt(len(r))))
    both = fits["base", "tool"][0]
    which = next(one for one in SETTLES if fits[one][0] <= ALIKE**2 * both)
    after, found, extra = fits[which]
    freedom = len(r) - Q.shape[1] - extra
    if freedom <= extra or before < CLEARLY**2 * after:
        return None
    if fdtrc(extra, freedom, (before - after) / extra / (after / freedom)) > CHANCE:
        return None
    twists = found * np.tile(np.concatenate([sigma[name] for name in which]), len(codes))
    moved = _largest_shift(twists, which, [len(frames[name]) for name in which], len(codes))
    points = len(r) / 3.0
    return SetUpChange(which, moved, float(np.sqrt(before / points)), float(np.sqrt(after / points)))


def _basis(J: Floats) -> Floats:
    """Orthonormal columns (R, k) of what the model's parameters move."""
    U, s, _ = np.linalg.svd(J, full_matrices=False)
    return np.asarray(U[:, s > SMALL * s[0]])


def _largest_shift(twists: Floats, which: tuple[str, ...], sizes: list[int], campaigns: int) -> float:
    """Longest shift (m) of a frame of any campaign."""
    lengths = []
    for one in np.split(twists, campaigns):
        start = 0
        for size, _ in zip(sizes, which, strict=True):
            lengths.append(float(np.linalg.norm(one[start : start + 3])))
            start += size
    return max(lengths)


ROWS = 100
STEPS = 3
KEPT = 0.95  # share of the rows, the nearest, that counts: an interrupted laser beam must not hide a mix-up
HALF, ROUNDS = 0.6, 6  # share of the rows that counts where many may be wrong, and how often they are chosen anew
FRAMES = 9  # numbers of a base pose and a tool point

# real size over stated size -> what was called what, for values said to be in mm
FACTORS = (1e-3, 1 / 25.4, 1e-2, 0.1, 10.0, 25.4, 100.0, 1e3)
LEAST_MOTION_M = 0.02
GOOD, BAD = 0.05, 0.25  # of what the chain's lengths move is left when the points fit the robot, and when they do not


@dataclass(frozen=True)
class Placed:
    """Flange poses placed at points: ``miss (K,)`` m, base rotation and place, tool point, rms ``size`` m of what is left."""

    rotation: Floats
    place: Floats
    tool: Floats
    miss: Floats
    size: float

    def predict_points(self, flange: Floats) -> Floats:
        """Points (K, 3) of flange poses (K, 4, 4)."""
        return (flange[:, :3, 3] + flange[:, :3, :3] @ self.tool) @ self.rotation.T + self.place


def place(flange: Floats, points: Floats, limit: float = np.inf) -> Placed:
    """Best base and tool for flange poses (K, 4, 4) and the points (K, 3) measured with them, the farthest rows aside.

    What leaves more than ``limit`` m with all rows is not placed again without the farthest.
    """
    flange, points = np.ascontiguousarray(flange), np.ascontiguousarray(points)
    return _place_once(flange.tobytes(), points.tobytes(), limit)


@lru_cache(maxsize=4)  # several checks look at the same rows
def _place_once(flange_bytes: bytes, point_bytes: bytes, limit: float) -> Placed:
    flange, points = np.frombuffer(flange_bytes).reshape(-1, 4, 4), np.frombuffer(point_bytes).reshape(-1, 3)
    near = np.ones(len(points), dtype=bool)
    placed = _fit_placement(flange, points, near, None)
    for _ in range(STEPS if placed.size <= limit else 0):
        before, near = near, _inlier_mask(placed.miss)
        if np.array_equal(before, near):
            break
        after = _fit_placement(flange, points, near, placed.rotation)
        if after.size >= placed.size:
            break
        placed = after
    return placed


def place_nearer(flange: Floats, points: Floats, placed: Placed) -> Placed:
    """Base and tool for the nearer half of the rows: where more than a few are nowhere near, they do not count at all."""
    for _ in range(ROUNDS):
        near = placed.miss <= np.quantile(placed.miss, HALF)
        after = _fit_placement(flange, points, near, None)
        if np.quantile(after.miss, HALF) >= np.quantile(placed.miss, HALF):
            break
        placed = after
    return placed


def _fit_placement(flange: Floats, points: Floats, near: Bools, rotation: Floats | None) -> Placed:
    """Base and tool that place the rows ``near`` best; near a base ``rotation`` (3, 3) where one is known."""
    base, tool = best_frames(flange[near, :3, 3], flange[near, :3, :3], points[near], np.zeros(3), near=rotation)
    return _with_residuals(Placed(base[:3, :3], base[:3, 3], tool, np.zeros(0), 0.0), flange, points)


def _with_residuals(placed: Placed, flange: Floats, points: Floats) -> Placed:
    miss = np.linalg.norm(points - placed.predict_points(flange), axis=1)
    near = miss[_inlier_mask(miss)]
    size = np.sqrt(np.sum(near**2) / max(len(near) - FRAMES / 3.0, 1.0))
    return replace(placed, miss=miss, size=float(size))


def _inlier_mask(miss: Floats) -> Bools:
    last = int(KEPT * (len(miss) - 1))
    return np.asarray(miss <= np.partition(miss, last)[last])


@dataclass(frozen=True)
class Sample:
    """Up to ``ROWS`` rows of a campaign, in the order they were measured; ``row`` are their numbers from 0.

    ``points (K, 3)`` and, where measured, ``rotations (K, 3, 3)`` are of the tool. ``elsewhere`` are the joints of other
    rows, by the names of :data:`kilter_core.identify.plausibility.mix_ups.ELSEWHERE`.
    """

    begin: Calibration
    q: Floats
    points: Floats
    rotations: Floats | None
    row: Ints
    session: Ints
    elsewhere: dict[str, Floats]
    limit: float = np.inf  # m that the start of a placement may leave and still be refined

    @staticmethod
    def from_measurement(begin: Calibration, measurement: Measurement) -> Sample:
        """Take distinct poses evenly from the rows whose tool can be seen."""
        o = measurement.observations
        row = _of_each_pose(o.pose_groups())
        row = row[np.unique(np.linspace(0, len(row) - 1, min(ROWS, len(row))).astype(np.int64))]
        points, rotations, use = seen_tool(measurement, o.select(row))
        row, q = row[use], o.q
        session = np.zeros(len(row), dtype=np.int64) if o.session is None else o.session[row]
        # The rows of a session stay together, those of one in time.
        order = np.lexsort((row if o.t is None else o.t[row], session))
        row, session = row[order], session[order]
        elsewhere = {name: q[of(len(q))[row]] for name, (_, _, of) in ELSEWHERE.items()}
        rotations = None if rotations is None else rotations[use][order]
        bare = begin.with_effects(())
        bare = replace(bare, model=bare.model.in_frames(np.eye(4), np.eye(4)))
        return Sample(bare, q[row], points[use][order], rotations, row, session, elsewhere)

    def __len__(self) -> int:
        return len(self.q)

    def select_rows(self, index: Ints) -> Sample:
        """Some of the rows."""
        return replace(
            self,
            q=self.q[index],
            points=self.points[index],
            row=self.row[index],
            session=self.session[index],
            rotations=None if self.rotations is None else self.rotations[index],
            elsewhere={name: q[index] for name, q in self.elsewhere.items()},
        )

    def undo_mix_up(self, mix_up: MixUp) -> Sample:
        """The rows read as they would have been without a mix-up."""
        unit = wire_units(self.begin.robot)
        q = self.elsewhere[mix_up.rows] if mix_up.rows else self.q
        points, rotations = mix_up.poses(self.points, self.rotations)
        return replace(
            self,
            q=mix_up.joints(q, unit),
            limit=self.limit * max(1.0, mix_up.length),
            points=points,
            rotations=rotations,
            elsewhere={name: mix_up.joints(q, unit) for name, q in self.elsewhere.items()},
        )

    @cached_property
    def flange(self) -> Floats:
        """Flange poses (K, 4, 4) in the robot's base frame, without effects."""
        return self.predict_flange(self.q)

    def predict_flange(self, q: Floats) -> Floats:
        """The same of other joints (K, n)."""
        seen = self.begin.predict(Observations(q=q))
        out = np.tile(np.eye(4), (len(q), 1, 1))
        out[:, :3, :3], out[:, :3, 3] = seen.rotation, seen.position
        return out

    @cached_property
    def fitted_placement(self) -> Placed:
        """The rows placed on the robot by base and tool alone."""
        return place(self.flange, self.points, self.limit)

    @cached_property
    def lengths(self) -> float:
        """Rms length (m) of what the flange's places show of the chain beside one point fixed to the flange.

        A point fixed to the flange is what the tool takes up; zero where the flange only rotates about one point.
        """
        return untold(self.flange)

    @cached_property
    def spread(self) -> float:
        """Rms distance (m) of the points, or of the flange where that is less, from their middle."""
        return min(_spread(self.points), _spread(self.flange[:, :3, 3]))


def untold(flange: Floats) -> float:
    """Rms motion (m) of flange poses (K, 4, 4) that no point fixed to the flange takes up; zero on a sphere."""
    f, F = flange[:, :3, 3], flange[:, :3, :3]
    known = np.concatenate([np.tile(np.eye(3), (len(f), 1, 1)), F], axis=2).reshape(-1, 6)
    left = f.reshape(-1) - known @ np.linalg.lstsq(known, f.reshape(-1), rcond=None)[0]
    return float(np.sqrt(np.sum(left**2) / len(f)))


def _of_each_pose(pose: Ints) -> Ints:
    """A row of every pose, in turn the first and the last of it: rows that are one off show at the ends of its repeats."""
    first = np.unique(pose, return_index=True)[1]
    last = len(pose) - 1 - np.unique(pose[::-1], return_index=True)[1]
    return np.sort(np.where(np.arange(len(first)) % 2 == 0, first, last))


def seen_tool(measurement: Measurement, rows: Observations) -> tuple[Floats, Floats | None, Bools]:
    """Points (N, 3) and, where measured, rotations of the tool, and in which rows they can be told."""
    if rows.markers_of_poses is not None and measurement.marker_points is not None:
        return fit_poses(measurement.marker_points, rows.markers_of_poses)
    assert rows.position is not None
    return rows.position, rows.rotation, np.ones(len(rows), dtype=bool)


def _spread(points: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))


def unit_factor(robot: Robot, q: Floats, points: Floats) -> float | None:
    """By how much ``points (N, 3)`` m must be multiplied to fit the robot at joints ``q (N, n)``; None where they may fit.

    The point may sit anywhere on the tool and the instrument may be anywhere: both are fitted for every factor. What a tool
    of any length takes up, as of points on a sphere, tells no unit.
    """
    seen = ~np.isnan(points).any(axis=1)
    model = Calibration.nominal(robot).model
    pose = model.in_frames(np.eye(4), np.eye(4)).predict(Observations(q[seen]), model.values0())
    p = points[seen]
    flange = np.tile(np.eye(4), (len(p), 1, 1))
    flange[:, :3, :3], flange[:, :3, 3] = pose.rotation, pose.position
    motion = untold(flange) if len(p) else 0.0
    if len(p) < 6 or motion < LEAST_MOTION_M:
        return None
    fits = place(flange, p).size / motion
    if not fits > BAD:  # as nearly always: nothing else needs to be tried
        return None
    left = np.array([place(flange, factor * p).size for factor in FACTORS]) / motion
    best = int(np.argmin(left))
    return FACTORS[best] if left[best] < GOOD and left[best] < 0.2 * fits else None
