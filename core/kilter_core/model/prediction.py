"""What a model predicts of rows: where the tool is, and what its joints rotate by."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_core.model.chain_rule import Total
from kilter_core.types import Bools, Floats

TOOL_ROWS = 6  # of a Jacobian: position, then rotation vector of the tool
JOINT_ROWS = 4  # of each joint behind them: correction of its angle, then its rotation about x, y and z of its frame
ABOUT, TURNED = 0, slice(1, 4)  # places of these among the four


@dataclass(frozen=True)
class Prediction:
    """Tool ``position (N, 3)`` m and ``rotation (N, 3, 3)`` in the frame of the measurements.

    ``local`` are the corrections at the joints that it was made with, and ``slides (n,)`` marks prismatic joints.
    """

    position: Floats
    rotation: Floats
    local: Total | None = None
    slides: Bools | None = None

    @property
    def joints(self) -> Floats:
        """What each joint, and last the base, rotates by beyond its command (N, n + 1, 4): see :data:`JOINT_ROWS`."""
        assert self.local is not None
        return self.local.turned()
