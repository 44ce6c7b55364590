"""Positions and poses of the tool, and how well position and rotation are known together.

A view knows the tilt of its board badly, and a wrong tilt moves the tool by its lever: the two errors go together, over half
a metre and more for a camera on the flange. Taken apart, as the deviation of each axis alone, most of what the view knows is
lost. So the rotation is weighed by its own covariance, and the position by what is left of its own beside the rotation, with
the lever taken off: together they hold all that the six by six covariance says.

Relative calibration: only the distances between the poses count, so the base has no place and needs none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kilter_core.errors import ObservationError, TooFewPosesError
from kilter_core.measurement.kind import POINTS, TURNS, Block, Kind, Rows, ToolKind
from kilter_core.measurement.markers import marker_residuals
from kilter_core.model import Calibration, Prediction
from kilter_core.observations import Observations
from kilter_core.transforms import right_jacobian_inverse, rotation_log
from kilter_core.types import Bools, Floats, Ints


@dataclass(frozen=True)
class Poses(ToolKind):
    """Rows with a position and an orientation."""

    name = "poses"
    summary = "position and orientation of the tool"
    with_orientation = True

    observations: Observations

    @classmethod
    def from_rows(cls, rows: Rows) -> Poses | None:
        """Rows that have both."""
        o = rows.observations
        if rows.relative or o.position is None or o.rotation is None or o.markers is not None:
            return None
        return cls(o)

    @property
    def column(self) -> Floats:
        """Positions."""
        assert self.observations.position is not None
        return self.observations.position

    def scalars(self) -> int:
        """Six of every measured pose."""
        return 2 * super().scalars()

    def blocks(self, prediction: Prediction, J: Floats | None = None) -> tuple[Block, ...]:
        """Position (N, 1, 3) m and rotation vector (N, 1, 3) rad, measured minus predicted.

        Where rows say how position and rotation are known together, both are weighed by it: the position is that which is
        left beside what the rotation, with its lever, explains.
        """
        rotation = self.observations.rotation
        assert rotation is not None
        points = self.column - prediction.position
        turns = rotation_log(rotation @ prediction.rotation.transpose(0, 2, 1))
        d_points = None if J is None else J[:, :3, :]
        d_turns = None if J is None else right_jacobian_inverse(turns) @ J[:, 3:6, :]
        W = self.observations.pose_weight
        if W is not None:
            both = (W @ np.concatenate([points, turns], axis=1)[:, :, None])[:, :, 0]
            points, turns = both[:, :3], both[:, 3:]
        if W is not None and d_points is not None and d_turns is not None:
            d_both = W @ np.concatenate([d_points, d_turns], axis=1)
            d_points, d_turns = d_both[:, :3], d_both[:, 3:]
        return (
            Block(POINTS, points[:, None], None if d_points is None else d_points[:, None]),
            Block(TURNS, turns[:, None], None if d_turns is None else d_turns[:, None], "rad"),
        )

    def errors(self, calibration: Calibration) -> tuple[Floats, Floats | None]:
        """Errors (K, 3) m and (K,) rad of the poses, none weighed."""
        if self.observations.pose_weight is None:
            return super().errors(calibration)
        return Poses(replace(self.observations, pose_weight=None)).errors(calibration)


@dataclass(frozen=True)
class Points(ToolKind):
    """Rows with a position and nothing else of the tool."""

    name = "points"
    summary = "positions of the tool point"
    observations: Observations

    @classmethod
    def from_rows(cls, rows: Rows) -> Points | None:
        """Rows that have a position."""
        o = rows.observations
        if rows.relative or o.position is None or o.rotation is not None or o.markers is not None:
            return None
        return cls(o)

    @property
    def column(self) -> Floats:
        """Positions."""
        assert self.observations.position is not None
        return self.observations.position

    def blocks(self, prediction: Prediction, J: Floats | None = None) -> tuple[Block, ...]:
        """Measured minus predicted position (N, 1, 3) m."""
        points = (self.column - prediction.position)[:, None, :]
        return (Block(POINTS, points, None if J is None else J[:, None, :3, :]),)


Scale = tuple[float, float]
"""Standard deviations m and rad that weighed numbers of points and of rotations are told in."""
DEVIATIONS: Scale = (1.0, 1.0)  # plain numbers, whose covariance is one


def typical_deviations(covariance: Floats) -> Scale:
    """The typical deviations of poses with a covariance (N, 6, 6): m beside their rotation, and rad."""
    beside, _, turn = _split_covariance(covariance)
    m, rad = (float(np.sqrt(np.median(np.trace(C, axis1=1, axis2=2) / 3.0))) for C in (beside, turn))
    return m, rad


def weights(covariance: Floats, scale: Scale) -> Floats:
    """Matrices (N, 6, 6) that take errors of poses (m, rad) to numbers of deviations ``scale``, independent of each other.

    The square of what they give is that of the errors by the inverse of their ``covariance (N, 6, 6)``.
    """
    beside, lever, turn = _split_covariance(covariance)
    W = np.zeros_like(covariance)
    W[:, :3, :3] = scale[0] * _root_inverse(beside)
    W[:, :3, 3:] = -W[:, :3, :3] @ lever
    W[:, 3:, 3:] = scale[1] * _root_inverse(turn)
    return W


def beside_rotation(weight: Floats) -> float:
    """Typical deviation m of a coordinate beside the rotation, of poses weighed (N, 6, 6) in numbers of deviations."""
    root = np.linalg.inv(weight[:, :3, :3])
    return float(np.sqrt(np.median(np.sum(root**2, axis=(1, 2)) / 3.0)))


def _split_covariance(covariance: Floats) -> tuple[Floats, Floats, Floats]:
    """Covariance of the position beside the rotation, how it follows the rotation, and that of the rotation; (N, 3, 3) each."""
    P, Q, R = covariance[:, :3, :3], covariance[:, :3, 3:], covariance[:, 3:, 3:]
    lever = Q @ np.linalg.inv(R)
    return np.asarray(P - lever @ Q.transpose(0, 2, 1)), np.asarray(lever), R


def _root_inverse(C: Floats) -> Floats:
    """Symmetric roots of inverses (N, 3, 3): they keep the axes of what they weigh."""
    w, V = np.linalg.eigh(C)
    return np.asarray((V / np.sqrt(w)[:, None, :]) @ V.transpose(0, 2, 1))


RINGS = 8  # rings through all rows: each row meets sixteen others, near the information of all pairs at a fixed price
NOWHERE_M = 1e-9
FEWEST_POSES = 5


@dataclass(frozen=True)
class Distances(Kind):
    """Distances between the tool points (or the same marker) of ``pairs (M, 2)`` of rows.

    Residuals are scaled so that their squares hold the information of the 3 N - 6 numbers that distances between N points
    know, and their standard deviation is that of a coordinate.
    """

    name = "distances"
    summary = "distances between poses (base removed)"
    observes_tool = True
    plain_fits_only = True

    observations: Observations
    shape: Floats | None = None

    @classmethod
    def from_rows(cls, rows: Rows) -> Distances | None:
        """Rows with positions or markers, where only their distances are to count."""
        o = rows.observations
        if not rows.relative or (o.position is None and o.markers is None):
            return None
        return cls(o, rows.marker_points)

    def check(self) -> None:
        """Refuse fewer than five distinct poses."""
        poses = int(self.observations.pose_groups().max()) + 1
        if poses < FEWEST_POSES:
            raise TooFewPosesError(
                f"{poses} distinct poses have too few distances between them: measure five or more.",
                poses=poses,
                needed=FEWEST_POSES,
            )
        if not self.measured_row_mask().all():
            raise ObservationError(
                "Distances between poses need the tool measured in every row: leave the others out, or free the base."
            )

    def measured_row_mask(self) -> Bools:
        """Rows that have a point."""
        return np.asarray(~np.isnan(self._points).all(axis=(1, 2)))

    @cached_property
    def pairs(self) -> Ints:
        """Pairs (M, 2) of rows."""
        return _rings(self.observations.pose_groups())

    @property
    def observes_orientation(self) -> bool:
        """Whether markers show rotations of the tool."""
        return self.shape is not None

    @property
    def equations_per_pose(self) -> int:
        """As many as the points of a pose have."""
        return 6 if self.observes_orientation else 3

    @property
    def redundancy(self) -> float:
        """Pairs for each independent number."""
        return max(len(self.pairs) * int(self._points.shape[1]) / self.scalars(), 1.0)

    def numbers(self) -> int:
        """Independent numbers of the distinct poses: the six of their common place are lost."""
        return super().numbers() - 6

    def scalars(self) -> int:
        """Independent scalars of the rows."""
        o = self.observations
        seen = 3 * len(o) if o.markers is None else int(np.count_nonzero(~np.isnan(o.markers)))
        return max(seen - 6, 1)

    def blocks(self, prediction: Prediction, J: Floats | None = None) -> tuple[Block, ...]:
        """Measured minus predicted distances (M, m, 1) m, scaled."""
        points, d_points = self._predict_points(prediction, J)
        a, b = self.pairs.T
        scale = 1.0 / math.sqrt(2.0 * self.redundancy)
        apart = points[a] - points[b]
        size = np.maximum(np.linalg.norm(apart, axis=2), NOWHERE_M)
        left = (self._measured_distances() - size)[:, :, None] * scale
        if d_points is None:
            return (Block(POINTS, left),)
        slope = np.einsum("kmi,kmip->kmp", apart / size[:, :, None], d_points[a] - d_points[b]) * scale
        return (Block(POINTS, left, slope[:, :, None, :]),)

    def errors(self, calibration: Calibration) -> tuple[Floats, Floats | None]:
        """Errors (K, 1) m of the distances."""
        points, _ = super().errors(calibration)
        return points * math.sqrt(2.0 * self.redundancy), None

    @property
    def _points(self) -> Floats:
        """Measured points (N, m, 3)."""
        o = self.observations
        points = o.markers if o.markers is not None else o.position
        assert points is not None
        return points.reshape(len(o), -1, 3)

    def _measured_distances(self) -> Floats:
        a, b = self.pairs.T
        return np.asarray(np.linalg.norm(self._points[a] - self._points[b], axis=2))

    def _predict_points(self, prediction: Prediction, J: Floats | None) -> tuple[Floats, Floats | None]:
        """Predicted points (N, m, 3) and their Jacobian (N, m, 3, P)."""
        if self.shape is None:
            return prediction.position[:, None, :], None if J is None else J[:, None, :3, :]
        left, d_points = marker_residuals(
            np.zeros((len(self.observations), *self.shape.shape)), self.shape, prediction, J
        )
        return -left, d_points


def _rings(groups: Ints) -> Ints:
    """Pairs (M, 2) of neighbours in ``RINGS`` random rings through the rows, repeats of one pose never with each other."""
    rng, rows = np.random.default_rng(0), len(groups)
    rings = [rng.permutation(rows) for _ in range(RINGS)]
    pairs = np.concatenate([np.stack([ring, np.roll(ring, 1)], axis=1) for ring in rings])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    return np.asarray(pairs[groups[pairs[:, 0]] != groups[pairs[:, 1]]])
