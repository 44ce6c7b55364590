"""Relative calibration: only the distances between the poses count, so the base has no place and needs none."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from kilter_core.errors import TooFewPosesError
from kilter_core.measurement import Measurement, Residual
from kilter_core.model import Calibration, Prediction
from kilter_core.observations import Observations

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

RINGS = 8  # rings through all rows: each row meets sixteen others, near the information of all pairs at a fixed price
NOWHERE_M = 1e-9


@dataclass(frozen=True)
class Distances(Measurement):
    """Distances between the tool points (or the same marker) of ``pairs (M, 2)`` of rows.

    Residuals are scaled so that their squares hold the information of the 3 N - 6 numbers that distances between N points
    know, and their standard deviation is that of a coordinate.
    """

    pairs: Ints = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))

    @staticmethod
    def of(observations: Observations, marker_points: Floats | None = None) -> Distances:
        """Pair the rows.

        Raises:
            ObservationError: nothing measured. TooFewPosesError: fewer than five distinct poses.

        """
        plain = Measurement.of(observations, marker_points)
        poses = int(observations.pose_groups().max()) + 1
        if poses < 5:
            raise TooFewPosesError(
                f"{poses} distinct poses have too few distances between them: measure five or more.",
                poses=poses,
                needed=5,
            )
        return Distances(observations, plain.marker_points, _rings(observations.pose_groups()))

    @property
    def sees_base(self) -> bool:
        """No: moving the base moves no distance."""
        return False

    @property
    def redundancy(self) -> float:
        """Pairs for each independent number."""
        shape = self.marker_points
        return max(len(self.pairs) * (1 if shape is None else len(shape)) / self.scalars(), 1.0)

    @property
    def sees_orientation(self) -> bool:
        """Whether markers show turns of the tool."""
        return self.marker_points is not None

    def numbers(self) -> int:
        """Independent numbers of the distinct poses: the six of their common place are lost."""
        return super().numbers() - 6

    def scalars(self) -> int:
        """Independent scalars of the rows."""
        o = self.observations
        seen = 3 * len(o) if o.markers is None else int(np.count_nonzero(~np.isnan(o.markers)))
        return max(seen - 6, 1)

    def residual(self, prediction: Prediction, J: Floats | None = None) -> Residual:
        """Measured minus predicted distances (M, m, 1) with the Jacobian of the prediction, scaled."""
        points, d_points = _points(self, prediction, J)
        a, b = self.pairs.T
        scale = 1.0 / math.sqrt(2.0 * self.redundancy)
        apart = points[a] - points[b]
        size = np.maximum(np.linalg.norm(apart, axis=2), NOWHERE_M)
        left = (self._measured() - size)[:, :, None] * scale
        if d_points is None:
            return Residual(left, None, None, None)
        slope = np.einsum("kmi,kmip->kmp", apart / size[:, :, None], d_points[a] - d_points[b]) * scale
        return Residual(left, slope[:, :, None, :], None, None)

    def misses(self, calibration: Calibration) -> tuple[Floats, Floats | None]:
        """Errors (K, 1) m of the distances."""
        points, _ = super().misses(calibration)
        return points * math.sqrt(2.0 * self.redundancy), None

    def _measured(self) -> Floats:
        o = self.observations
        points = o.markers if o.markers is not None else o.position
        assert points is not None
        points = points.reshape(len(o), -1, 3)
        a, b = self.pairs.T
        return np.asarray(np.linalg.norm(points[a] - points[b], axis=2))


def _points(measurement: Distances, prediction: Prediction, J: Floats | None) -> tuple[Floats, Floats | None]:
    """Predicted points (N, m, 3) and their Jacobian (N, m, 3, P): the residual of points measured at zero."""
    o = measurement.observations
    if measurement.marker_points is None:
        zero = Observations(o.q, position=np.zeros((len(o), 3)))
        residual = Measurement(zero).residual(prediction, J)
    else:
        zero = Observations(o.q, markers=np.zeros((len(o), len(measurement.marker_points), 3)))
        residual = Measurement(zero, measurement.marker_points).residual(prediction, J)
    return -residual.points, residual.d_points


def _rings(groups: Ints) -> Ints:
    """Pairs (M, 2) of neighbours in ``RINGS`` random rings through the rows, repeats of one pose never with each other."""
    rng, rows = np.random.default_rng(0), len(groups)
    rings = [rng.permutation(rows) for _ in range(RINGS)]
    pairs = np.concatenate([np.stack([ring, np.roll(ring, 1)], axis=1) for ring in rings])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    return np.asarray(pairs[groups[pairs[:, 0]] != groups[pairs[:, 1]]])
