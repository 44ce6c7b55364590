"""Where planned poses may be: joint limits, where the arm was driven before, a floor, a box. Collisions are not checked."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull

from kilter_core.arm.kernels import kinematics
from kilter_core.arm.robot import Robot
from kilter_core.errors import RobotError
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.parameters import mm
from kilter_core.types import Bools, Floats

MARGIN_SHARE = 0.03  # of a joint's range kept free at both ends of its limits: room for a correction
BESIDE_M = 0.02  # how far a point of the arm may be outside the hull of where it was: the arm moved between poses too
FLAT = 1e-6  # share of the largest spread below which a direction of a hull has no width
STILL_M = 1e-4
MOST_POINTS = 20_000
BATCH, BATCHES = 20_000, 30  # random poses tried to fill a region
MOST_DISTANCES = 1_000_000  # of points from faces at a time, 8 MB: hulls of a thousand poses have over a thousand faces
LEFT = "collisions are not checked"


@dataclass(frozen=True)
class Region:
    """Poses that may be proposed.

    ``low`` and ``high (n,)`` bound the joints. ``hulls`` hold, for each joint's origin and the tool point of the nominal
    robot, where it was in earlier campaigns; none when those do not bound it. ``floor`` is a height m, along the vertical
    in the robot's base frame, that none of these points goes below, those aside that
    no joint raises. ``box (2, 3)`` m in the frame of the measurements
    holds the tool of ``start``. ``keep_out (k, 2, 3)`` m in that frame are boxes that no line between consecutive of these
    points enters.
    """

    start: Calibration
    low: Floats
    high: Floats
    hulls: tuple[Hull, ...] = ()
    floor: float | None = None
    box: Floats | None = None
    keep_out: Floats | None = None

    @staticmethod
    def from_calibration(start: Calibration, driven: Floats | None = None) -> Region:
        """Limits less a margin; with joint readings ``driven (N, n)`` also no farther than the arm was driven.

        Raises:
            RobotError: neither limits nor readings bound a joint.

        """
        robot = start.robot
        low, high = robot.limits.T
        margin = MARGIN_SHARE * (high - low)
        low, high = low + np.nan_to_num(margin, posinf=0.0), high - np.nan_to_num(margin, posinf=0.0)
        if driven is None or not len(driven):
            if not np.isfinite(robot.limits).all():
                raise RobotError("Planning poses needs the limits of every joint: give limits_deg.", field="joints")
            return Region(start, low, high)
        driven = driven[:: -(-len(driven) // MOST_POINTS)]
        low, high = np.maximum(low, driven.min(axis=0)), np.minimum(high, driven.max(axis=0))
        points = arm_points(robot, driven)
        return Region(
            start, low, np.maximum(low, high), tuple(Hull.from_points(points[:, k]) for k in range(points.shape[1]))
        )

    def above(self, floor: float | None) -> Region:
        """Return the region above a floor."""
        return replace(self, floor=floor)

    def restrict_to_box(self, box: Floats | None) -> Region:
        """Return the part of the region whose tool is in a box."""
        return replace(self, box=box)

    def outside(self, keep_out: Floats | None) -> Region:
        """Return the part of the region whose arm keeps out of boxes (k, 2, 3)."""
        return replace(self, keep_out=keep_out)

    def holds(self, q: Floats) -> Bools:
        """Which joint vectors (N, n) are in it."""
        inside = np.asarray(((q >= self.low) & (q <= self.high)).all(axis=1)) & self.clear(q)
        if self.hulls:
            points = arm_points(self.start.robot, q)
            for k, hull in enumerate(self.hulls):
                inside &= hull.holds(points[:, k])
        return inside

    def clear(self, q: Floats) -> Bools:
        """Which joint vectors (N, n), wherever they are otherwise, keep to the floor and the box and out of others."""
        inside = np.ones(len(q), dtype=bool)
        if self.floor is not None:
            inside &= (self._heights(q)[:, self._rising] >= self.floor).all(axis=1)
        if self.box is not None:
            tool = self.start.predict(Observations(q)).position
            inside &= ((tool >= self.box[0]) & (tool <= self.box[1])).all(axis=1)
        if self.keep_out is not None:
            T = self.start.model.T_base
            points = arm_points(self.start.robot, q) @ T[:3, :3].T + T[:3, 3]
            inside &= ~np.any([entering(points, box) for box in self.keep_out], axis=0)
        return inside

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Joint vectors (count, n), uniform within the region.

        Raises:
            RobotError: hardly a pose is in it.

        """
        found: list[Floats] = []
        batch = max(4 * count, 200)
        tried = 0
        for _ in range(BATCHES):
            q = rng.uniform(self.low, self.high, (batch, len(self.low)))
            found.append(q[self.holds(q)])
            tried += batch
            if sum(map(len, found)) >= count:
                return np.concatenate(found)[:count]
            batch = BATCH
        raise RobotError(
            f"Of {tried} random poses only {sum(map(len, found))} are {self._bounds()}, {count} are needed to choose from: "
            f"{self._more_room()}.",
            field="box_mm" if self.box is not None else "keep_out_mm" if self.keep_out is not None else "joints",
        )

    @cached_property
    def _rising(self) -> Bools:
        """Points (n + 1,) that the joints raise and lower: no pose lifts the shoulder off its mount."""
        q = np.random.default_rng(0).uniform(self.low, self.high, (100, len(self.low)))
        return np.asarray(np.ptp(self._heights(q), axis=0) > STILL_M)

    def _heights(self, q: Floats) -> Floats:
        up = -self.start.robot.gravity / np.linalg.norm(self.start.robot.gravity)
        return np.asarray(arm_points(self.start.robot, q) @ up)

    def _bounds(self) -> str:
        parts = ["within the limits"]
        parts += ["where the arm was driven before"] if self.hulls else []
        parts += [f"above {mm(self.floor):g} mm"] if self.floor is not None else []
        parts += ["with the tool in the box"] if self.box is not None else []
        parts += ["out of the zones to keep out of"] if self.keep_out is not None else []
        return ", ".join(parts)

    def _more_room(self) -> str:
        ways = ["take a larger box"] if self.box is not None else []
        ways += ["keep out of less"] if self.keep_out is not None else []
        ways += ["lower the floor"] if self.floor is not None else []
        ways += ["go to the limits (--anywhere)"] if self.hulls else []
        return " or ".join(ways) or "give more room"


@dataclass(frozen=True)
class Hull:
    """Convex hull of points: within ``axes (3, d)`` about ``centre`` by half-spaces, and flat across them."""

    centre: Floats
    axes: Floats
    half: Floats  # (F, d + 1): normal and offset of each face, in the axes; a segment's are its ends

    @staticmethod
    def from_points(points: Floats) -> Hull:
        """Hull of points (N, 3), which may lie in a plane, on a line, or be one."""
        centre = points.mean(axis=0)
        _, s, Vt = np.linalg.svd(points - centre, full_matrices=False)
        wide = s > max(FLAT * float(s[0]), FLAT)
        axes = Vt[wide].T
        inside = (points - centre) @ axes
        if axes.shape[1] == 0:
            half = np.zeros((0, 1))
        elif axes.shape[1] == 1:
            half = np.array([[1.0, -float(inside.max())], [-1.0, float(inside.min())]])
        else:
            half = np.asarray(ConvexHull(inside).equations) if len(inside) > axes.shape[1] else np.zeros((0, 1))
        return Hull(centre, axes, half)

    def holds(self, points: Floats) -> Bools:
        """Which points (N, 3) are in the hull or no farther than ``BESIDE_M`` from its faces."""
        apart = points - self.centre
        along = apart @ self.axes
        inside = np.linalg.norm(apart - along @ self.axes.T, axis=1) <= BESIDE_M
        size = max(1, MOST_DISTANCES // max(1, len(self.half)))
        for k in range(0, len(points), size):
            faces = along[k : k + size] @ self.half[:, :-1].T + self.half[:, -1]
            inside[k : k + size] &= (faces <= BESIDE_M).all(axis=1)
        return np.asarray(inside)


def entering(points: Floats, box: Floats) -> Bools:
    """Which of the lines through points (N, m, 3), each to the next, enter a box (2, 3)."""
    begin, way = points[:, :-1], np.diff(points, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (box[:, None, None, :] - begin) / way  # of the part of each line that is between the faces of an axis
    still = way == 0.0
    between = (begin >= box[0]) & (begin <= box[1])
    first = np.where(still, np.where(between, -np.inf, np.inf), ends.min(axis=0)).max(axis=2)
    last = np.where(still, np.where(between, np.inf, -np.inf), ends.max(axis=0)).min(axis=2)
    return np.asarray((np.maximum(first, 0.0) <= np.minimum(last, 1.0)).any(axis=1))


def arm_points(robot: Robot, q: Floats) -> Floats:
    """Origins of the joints, then the tool point, (N, n + 1, 3) m in the base frame of the nominal robot."""
    program = robot.chain.program
    out = np.empty((len(q), robot.n_joints + 1, 3))
    still, rotation = np.zeros_like(q), np.empty((len(q), 3, 3))
    ends = [*program.primary.tolist(), len(program.axis)]
    for k, end in enumerate(ends):
        position = np.empty((len(q), 3))
        kinematics.poses(
            program.axis[:end],
            program.joint[:end],
            program.ratio[:end],
            program.value[:end],
            np.full(end, -1, dtype=np.int64),
            end,
            np.eye(4),
            robot.T_tool if k == robot.n_joints else np.eye(4),
            np.ascontiguousarray(q),
            still,
            np.zeros((0, 0, 6)),
            position,
            rotation,
        )
        out[:, k] = position
    return out
