"""A few rows of a campaign placed on the robot by base and tool alone: fast enough to try a hundred readings of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kilter_core.identify.plausibility.mix_ups import MixUp, wire_units
from kilter_core.measurement import Measurement
from kilter_core.measurement.marker_shape import fit_poses
from kilter_core.measurement.registration import linear_frames
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.transforms import nearest_rotation, skew
from kilter_core.types import Bools, Floats, Ints

ROWS = 100
STEPS = 3
KEPT = 0.95  # share of the rows, the nearest, that counts: an interrupted laser beam must not hide a mix-up
FRAMES = 9  # numbers of a base pose and a tool point


@dataclass(frozen=True)
class Placed:
    """Flange poses placed at points: ``miss (K,)`` m, base rotation and place, tool point, rms ``size`` m of what is left."""

    rotation: Floats
    place: Floats
    tool: Floats
    miss: Floats
    size: float

    def at(self, flange: Floats) -> Floats:
        """Points (K, 3) of flange poses (K, 4, 4)."""
        return (flange[:, :3, 3] + flange[:, :3, :3] @ self.tool) @ self.rotation.T + self.place


def place(flange: Floats, points: Floats, limit: float = np.inf) -> Placed:
    """Best base and tool for flange poses (K, 4, 4) and the points (K, 3) measured with them.

    A start that leaves more than ``limit`` m is not refined.
    """
    f, F = flange[:, :3, 3], flange[:, :3, :3]
    base, tool = linear_frames(f, F, points, np.zeros(3))
    placed = _measured(Placed(base[:3, :3], base[:3, 3], tool, np.zeros(0), 0.0), flange, points)
    for _ in range(STEPS if placed.size <= limit else 0):
        near = _near(placed.miss)
        after = _measured(_step(placed, flange[near], points[near]), flange, points)
        if after.size > 0.999 * placed.size:
            return after if after.size < placed.size else placed
        placed = after
    return placed


def _step(placed: Placed, flange: Floats, points: Floats) -> Placed:
    """One Gauss-Newton step in the nine numbers; a faint ridge holds what the poses do not determine."""
    arm = placed.at(flange) - placed.place
    J = np.concatenate([-skew(arm), np.tile(np.eye(3), (len(arm), 1, 1)), placed.rotation @ flange[:, :3, :3]], axis=2)
    J = J.reshape(-1, FRAMES)
    r = (points - placed.place - arm).reshape(-1)
    H = J.T @ J
    x = np.linalg.solve(H + 1e-8 * np.trace(H) * np.eye(FRAMES), J.T @ r)
    rotation = nearest_rotation((np.eye(3) + skew(x[None, :3])[0]) @ placed.rotation)
    return replace(placed, rotation=rotation, place=placed.place + x[3:6], tool=placed.tool + x[6:])


def _measured(placed: Placed, flange: Floats, points: Floats) -> Placed:
    miss = np.linalg.norm(points - placed.at(flange), axis=1)
    near = miss[_near(miss)]
    size = np.sqrt(np.sum(near**2) / max(len(near) - FRAMES / 3.0, 1.0))
    return replace(placed, miss=miss, size=float(size))


def _near(miss: Floats) -> Bools:
    last = int(KEPT * (len(miss) - 1))
    return np.asarray(miss <= np.partition(miss, last)[last])


@dataclass(frozen=True)
class Sample:
    """Up to ``ROWS`` rows of a campaign, in the order they were measured; ``row`` are their numbers from 0.

    ``points (K, 3)`` and, where measured, ``rotations (K, 3, 3)`` are of the tool. ``beside`` are the joints of rows a
    step away, ``opposite`` those of the row as far from the end.
    """

    begin: Calibration
    q: Floats
    points: Floats
    rotations: Floats | None
    row: Ints
    session: Ints
    beside: dict[int, Floats]
    opposite: Floats
    limit: float = np.inf  # m that the start of a placement may leave and still be refined

    @staticmethod
    def of(begin: Calibration, measurement: Measurement) -> Sample:
        """Take distinct poses evenly from the rows whose tool can be seen."""
        o = measurement.observations
        first = np.unique(o.pose_groups(), return_index=True)[1]
        row = np.sort(first)[np.unique(np.linspace(0, len(first) - 1, min(ROWS, len(first))).astype(np.int64))]
        points, rotations, use = _seen(measurement, o.select(row))
        row, q, last = row[use], o.q, len(o) - 1
        session = np.zeros(len(row), dtype=np.int64) if o.session is None else o.session[row]
        # The rows of a session stay together, those of one in time.
        order = np.lexsort((row if o.t is None else o.t[row], session))
        row, session = row[order], session[order]
        beside = {k: q[(row + k) % len(q)] for k in (-1, 1)}
        rotations = None if rotations is None else rotations[use][order]
        bare = begin.with_effects(())
        bare = replace(bare, model=bare.model.in_frames(np.eye(4), np.eye(4)))
        return Sample(bare, q[row], points[use][order], rotations, row, session, beside, q[last - row])

    def __len__(self) -> int:
        return len(self.q)

    def part(self, index: Ints) -> Sample:
        """Some of the rows."""
        return replace(
            self, q=self.q[index], points=self.points[index], row=self.row[index], session=self.session[index],
            rotations=None if self.rotations is None else self.rotations[index], opposite=self.opposite[index],
            beside={k: q[index] for k, q in self.beside.items()},
        )  # fmt: skip

    def without(self, mix_up: MixUp) -> Sample:
        """The rows read as they would have been without a mix-up."""
        unit = wire_units(self.begin.robot)
        q = self.opposite if mix_up.backwards else self.beside[mix_up.shift] if mix_up.shift else self.q
        return replace(
            self, q=mix_up.joints(q, unit), limit=self.limit * max(1.0, mix_up.length), points=mix_up.points(self.points),
            rotations=None if self.rotations is None else mix_up.rotations(self.rotations),
            beside={k: mix_up.joints(v, unit) for k, v in self.beside.items()},
            opposite=mix_up.joints(self.opposite, unit),
        )  # fmt: skip

    @cached_property
    def flange(self) -> Floats:
        """Flange poses (K, 4, 4) in the robot's base frame, without effects."""
        seen = self.begin.predict(Observations(q=self.q))
        out = np.tile(np.eye(4), (len(self.q), 1, 1))
        out[:, :3, :3], out[:, :3, 3] = seen.rotation, seen.position
        return out

    @cached_property
    def placed(self) -> Placed:
        """The rows placed on the robot by base and tool alone."""
        return place(self.flange, self.points, self.limit)

    @cached_property
    def spread(self) -> float:
        """Rms distance (m) of the points, or of the flange where that is less, from their middle."""
        return min(_spread(self.points), _spread(self.flange[:, :3, 3]))


def _seen(measurement: Measurement, rows: Observations) -> tuple[Floats, Floats | None, Bools]:
    if rows.markers is not None and measurement.marker_points is not None:
        return fit_poses(measurement.marker_points, rows.markers)
    assert rows.position is not None
    return rows.position, rows.rotation, np.ones(len(rows), dtype=bool)


def _spread(points: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))
