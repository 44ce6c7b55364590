"""Relative calibration: only the distances between the poses count, so the base has no place and needs none."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kilter_core.errors import ObservationError, TooFewPosesError
from kilter_core.measurement.kind import POINTS, Block, Kind, Rows
from kilter_core.measurement.markers import marker_residuals
from kilter_core.model import Calibration, Prediction
from kilter_core.observations import Observations
from kilter_core.types import Bools, Floats, Ints

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
