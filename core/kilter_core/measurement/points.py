"""Positions of the tool point: a laser tracker on one reflector, a measuring arm, a total station."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_core.measurement.kind import POINTS, Block, Rows, ToolKind
from kilter_core.model import Prediction
from kilter_core.observations import Observations
from kilter_core.types import Floats


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
