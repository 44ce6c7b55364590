"""Poses of the tool: position and orientation, as a probe with its own orientation or a camera gives them."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_core.measurement.kind import POINTS, TURNS, Block, Rows, ToolKind
from kilter_core.model import Prediction
from kilter_core.observations import Observations
from kilter_core.transforms import right_jacobian_inverse, rotation_log
from kilter_core.types import Floats


@dataclass(frozen=True)
class Poses(ToolKind):
    """Rows with a position and an orientation."""

    name = "poses"
    summary = "position and orientation of the tool"
    with_orientation = True

    observations: Observations

    @classmethod
    def of(cls, rows: Rows) -> Poses | None:
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
        """Position (N, 1, 3) m and rotation vector (N, 1, 3) rad, measured minus predicted."""
        rotation = self.observations.rotation
        assert rotation is not None
        points = (self.column - prediction.position)[:, None, :]
        turns = rotation_log(rotation @ prediction.rotation.transpose(0, 2, 1))
        if J is None:
            return Block(POINTS, points), Block(TURNS, turns[:, None], None, "rad")
        d_turns = right_jacobian_inverse(turns) @ J[:, 3:6, :]
        return Block(POINTS, points, J[:, None, :3, :]), Block(TURNS, turns[:, None], d_turns[:, None], "rad")
