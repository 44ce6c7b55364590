"""Positions of the tool point: a laser tracker on one reflector, a measuring arm, a total station."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.measurement.kind import POINTS, Block, Kind, Rows, seen_in
from kilter_core.model import Prediction
from kilter_core.observations import Observations
from kilter_core.types import Bools, Floats


@dataclass(frozen=True)
class Points(Kind):
    """Rows with a position and nothing else of the tool."""

    name = "points"
    summary = "positions of the tool point"
    observes_tool = True
    observes_base = True

    observations: Observations

    @classmethod
    def of(cls, rows: Rows) -> Points | None:
        """Rows that have a position."""
        o = rows.observations
        if rows.relative or o.position is None or o.rotation is not None or o.markers is not None:
            return None
        return cls(o)

    def measured(self) -> Bools:
        """Rows that have a position."""
        assert self.observations.position is not None
        return seen_in(self.observations.position)

    def scalars(self) -> int:
        """Three of every measured point."""
        assert self.observations.position is not None
        return int(np.count_nonzero(~np.isnan(self.observations.position)))

    def blocks(self, prediction: Prediction, J: Floats | None = None) -> tuple[Block, ...]:
        """Measured minus predicted position (N, 1, 3) m."""
        assert self.observations.position is not None
        points = (self.observations.position - prediction.position)[:, None, :]
        return (Block(POINTS, points, None if J is None else J[:, None, :3, :]),)
