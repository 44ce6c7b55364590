"""Poses of the tool: position and orientation, as a probe with its own orientation or a camera gives them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kilter_core.measurement.kind import POINTS, TURNS, Block, Rows, ToolKind
from kilter_core.model import Calibration, Prediction
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
