"""What each stage of an identification leaves of every row, for pictures: in the axes of the robot's base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.arm.chain import increment
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.transforms import inverse
from kilter_core.types import Floats, Ints

FITTED = "identified"


@dataclass(frozen=True)
class RowErrors:
    """Errors by stage, measured minus predicted.

    Of measured points, ``left`` has (N, 3) m in the axes of the robot's base, the mean of a row's markers, NaN where none
    was seen; ``rows (N,)`` are their numbers from 0 and ``at (N, 3)`` m where the identified model has the tool in the
    robot's base frame. Distances and contacts are between rows: ``left`` has (K, 1) m, and ``rows`` and ``at`` are None.
    """

    left: Mapping[str, Floats]
    rows: Ints | None = None
    at: Floats | None = None

    @staticmethod
    def from_stages(stages: Mapping[str, Calibration], measurement: Measurement, rows: Ints) -> RowErrors:
        """Errors of calibrations on a measurement whose rows have these numbers."""
        if not measurement.observes_places:
            return RowErrors({name: measurement.errors(stage)[0] for name, stage in stages.items()})
        model, values = stages[FITTED].model, stages[FITTED].values
        base = inverse(model.T_base @ increment(values[:6]))
        predicted = stages[FITTED].predict(measurement.observations).position
        left = {name: _mean(stage, measurement) @ base[:3, :3].T for name, stage in stages.items()}
        return RowErrors(left, rows, predicted @ base[:3, :3].T + base[:3, 3])

    @staticmethod
    def concatenate(parts: Sequence[RowErrors]) -> RowErrors:
        """Pool folds, or set-ups of an instrument."""
        left = {name: np.concatenate([p.left[name] for p in parts]) for name in parts[0].left}
        rows, places = [p.rows for p in parts if p.rows is not None], [p.at for p in parts if p.at is not None]
        if len(rows) != len(parts) or len(places) != len(parts):
            return RowErrors(left)
        return RowErrors(left, np.concatenate(rows), np.concatenate(places))

    def with_row_numbers(self, numbers: Ints | None) -> RowErrors:
        """The same rows by their numbers among all that were given; as they are with None."""
        return self if self.rows is None or numbers is None else replace(self, rows=numbers[self.rows])

    @property
    def sizes(self) -> dict[str, Floats]:
        """Length (N,) m of what is left, by stage; rows without a measured point are left out."""
        out = {name: np.linalg.norm(e, axis=1) for name, e in self.left.items()}
        return {name: size[~np.isnan(size)] for name, size in out.items()}


def _mean(stage: Calibration, measurement: Measurement) -> Floats:
    """Error (N, 3) m of each row in the frame of the measurements: of its point, or the mean of the markers it shows."""
    return mean_marker_error(measurement.residual(stage.predict(measurement.observations)).points)


def mean_marker_error(points: Floats) -> Floats:
    """Mean (N, 3) of what markers (N, m, 3) are off by, over those that a row shows; NaN where it shows none."""
    seen = np.asarray(~np.isnan(points).any(axis=2))
    count = np.where(seen.any(axis=1), seen.sum(axis=1), np.nan)
    return np.asarray(np.where(seen[:, :, None], points, 0.0).sum(axis=1) / count[:, None])
