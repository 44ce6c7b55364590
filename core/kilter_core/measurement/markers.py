"""Markers on the tool, each measured as a point; together they show how the tool is oriented."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.measurement.kind import POINTS, Block, Rows, ToolKind
from kilter_core.measurement.marker_checks import refuse_bad_markers
from kilter_core.measurement.marker_shape import marker_shape
from kilter_core.model import Prediction
from kilter_core.observations import Observations
from kilter_core.transforms import skew
from kilter_core.types import Floats


def resolve_marker_shape(observations: Observations, known: Floats | None) -> Floats | None:
    """Places (m, 3) m of the markers in the tool frame: as ``known``, else as the rows show them; None without any.

    Raises:
        ObservationError: markers that are not a rigid set.

    """
    markers = observations.markers_of_poses
    if markers is None:
        return None
    refuse_bad_markers(markers, known)
    return marker_shape(markers, observations.tip) if known is None else known


@dataclass(frozen=True)
class Markers(ToolKind):
    """Rows with markers that stand at ``shape (m, 3)`` m in the tool frame."""

    name = "markers"
    summary = "markers on the tool"
    with_orientation = True

    observations: Observations
    shape: Floats

    @classmethod
    def from_rows(cls, rows: Rows) -> Markers | None:
        """Rows that have markers of a known shape."""
        if rows.relative or rows.observations.markers is None or rows.marker_points is None:
            return None
        return cls(rows.observations, rows.marker_points)

    @property
    def column(self) -> Floats:
        """Places of the markers; three or more fix the orientation."""
        assert self.observations.markers is not None
        return self.observations.markers

    def blocks(self, prediction: Prediction, J: Floats | None = None) -> tuple[Block, ...]:
        """Measured minus predicted markers (N, m, 3) m, NaN where one was not seen."""
        points, d_points = marker_residuals(self.column, self.shape, prediction, J)
        return (Block(POINTS, points, d_points),)


def marker_residuals(
    markers: Floats, shape: Floats, prediction: Prediction, J: Floats | None
) -> tuple[Floats, Floats | None]:
    """Residuals (N, m, 3) m of markers, and the derivative (N, m, 3, P) of the predicted ones."""
    arms = np.einsum("nij,mj->nmi", prediction.rotation, shape)
    points = markers - prediction.position[:, None, :] - arms
    if J is None:
        return points, None
    n, m = markers.shape[:2]
    crossed = -skew(arms.reshape(-1, 3)).reshape(n, m, 3, 3) @ J[:, None, 3:6, :]
    return points, J[:, None, :3, :] + crossed
