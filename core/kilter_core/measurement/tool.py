"""From predicted tool poses to what was measured: residuals, their Jacobian and their weights, per kind of data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kilter_core.errors import ObservationError
from kilter_core.measurement.marker_checks import refuse_bad_markers
from kilter_core.measurement.markers import marker_shape
from kilter_core.model import Calibration, Prediction
from kilter_core.observations import Observations
from kilter_core.transforms import right_jacobian_inverse, rotation_log, skew

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Residual:
    """Stacked residuals, measured minus predicted.

    ``points (N, m, 3)`` m ((M, m, 1) where lengths were measured), NaN where a marker was not seen, with ``d_points``
    (..., P); ``turns (N, 3)`` rad and
    ``d_turns (N, 3, P)`` where orientation was measured. The Jacobians are of the prediction (minus the residual's).
    """

    points: Floats
    d_points: Floats | None
    turns: Floats | None
    d_turns: Floats | None


@dataclass(frozen=True)
class Measurement:
    """What the rows measured of the tool: its point, its pose, or markers at ``marker_points`` in the tool frame."""

    observations: Observations
    marker_points: Floats | None = None

    @staticmethod
    def of(observations: Observations, marker_points: Floats | None = None) -> Measurement:
        """Wrap observations; the markers' shape is taken from them unless given.

        Raises:
            ObservationError: the rows measure neither position nor markers.

        """
        if observations.markers is not None:
            refuse_bad_markers(observations.markers, marker_points)
            points = marker_shape(observations.markers, observations.tip) if marker_points is None else marker_points
            return Measurement(observations, points)
        if observations.position is None:
            raise ObservationError(
                "The observations hold no measured position: upload x_mm, y_mm, z_mm, or markers m1x_mm and so on."
            )
        return Measurement(observations)

    @property
    def sees_orientation(self) -> bool:
        """Whether the tool's orientation was measured, by itself or through markers."""
        return self.observations.rotation is not None or self.marker_points is not None

    @property
    def sees_base(self) -> bool:
        """Whether the rows are told in a frame of their own, so that the base has a place in it."""
        return True

    @property
    def redundancy(self) -> float:
        """How many residuals there are for each number that is independent of the others."""
        return 1.0

    @property
    def settled(self) -> float:
        """Share of the loss that a step of a fit must promise to be worth taking, beside rounding."""
        return 0.0

    @property
    def each(self) -> int:
        """Numbers that one more pose brings."""
        return 6 if self.sees_orientation else 3

    def numbers(self) -> int:
        """Independent numbers of the distinct poses, repeats not counted."""
        return (int(self.observations.pose_groups().max()) + 1) * self.each

    def misses(self, calibration: Calibration) -> tuple[Floats, Floats | None]:
        """Errors (K, 3) m and rad (K,) of a calibration, in the units of what was measured; unseen markers left out."""
        residual = self.residual(calibration.predict(self.observations))
        points = residual.points.reshape(-1, residual.points.shape[-1])
        turns = None if residual.turns is None else np.linalg.norm(residual.turns, axis=1)
        return points[~np.isnan(points).any(axis=1)], turns

    def scalars(self) -> int:
        """Number of measured scalars that are independent."""
        o = self.observations
        if o.markers is not None:
            return int(np.count_nonzero(~np.isnan(o.markers)))
        return len(o) * (6 if o.rotation is not None else 3)

    def residual(self, prediction: Prediction, J: Floats | None = None) -> Residual:
        """Residuals of a prediction; with the model's Jacobian ``J (N, 6, P)`` also theirs."""
        o = self.observations
        if self.marker_points is not None and o.markers is not None:
            return self._of_markers(o.markers, self.marker_points, prediction, J)
        assert o.position is not None
        points = (o.position - prediction.position)[:, None, :]
        d_points = None if J is None else J[:, None, :3, :]
        if o.rotation is None:
            return Residual(points, d_points, None, None)
        turns = rotation_log(o.rotation @ prediction.rotation.transpose(0, 2, 1))
        d_turns = None if J is None else right_jacobian_inverse(turns) @ J[:, 3:, :]
        return Residual(points, d_points, turns, d_turns)

    @staticmethod
    def _of_markers(markers: Floats, shape: Floats, prediction: Prediction, J: Floats | None) -> Residual:
        arms = np.einsum("nij,mj->nmi", prediction.rotation, shape)
        points = markers - prediction.position[:, None, :] - arms
        if J is None:
            return Residual(points, None, None, None)
        n, m = markers.shape[:2]
        crossed = -skew(arms.reshape(-1, 3)).reshape(n, m, 3, 3) @ J[:, None, 3:, :]
        return Residual(points, J[:, None, :3, :] + crossed, None, None)
