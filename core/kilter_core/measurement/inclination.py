"""Inclinometers on links and base: how each joint rotates about the axes of its frame beyond its command, up to a constant.

A reading is that of the sensor behind the joint minus that of one before it. It separates clearance and tilting from a rotation
about the axis, which positions of the tool mix up. A sensor on the base reads how that rotates about the axes of the base
frame, which tells a mount that deflects from the first joints. A sensor mounted again, in another session, has another zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.measurement.kind import Block
from kilter_core.measurement.referenced import Channels, Referenced, offset_free_blocks
from kilter_core.model import Prediction
from kilter_core.model.prediction import JOINT_ROWS, TOOL_ROWS, TURNED
from kilter_core.types import Floats


@dataclass(frozen=True)
class Inclination(Referenced):
    """Rows with readings of inclinometers. ``anchor`` are the rows that say what they read at zero."""

    name = "inclination"
    summary = "inclinometers on links and base"
    column = "tilt"

    def blocks(self, prediction: Prediction, J: Floats | None = None) -> tuple[Block, ...]:
        """Measured minus predicted rotation (N, C, 1) rad, the mean of its session taken out: C is 3 n, or 3 n + 3 with
        the base.
        """
        columns = None
        if J is not None:
            joints = J[:, TOOL_ROWS:].reshape(len(J), -1, JOINT_ROWS, J.shape[2])
            columns = joints[:, : self._places, TURNED].reshape(len(J), -1, J.shape[2])
        return offset_free_blocks(self.name, self._channels, self._raw(prediction), columns)

    @property
    def _places(self) -> int:
        """Joints, and the base where it has a column."""
        assert self.observations.tilt is not None
        return int(self.observations.tilt.shape[1])

    @property
    def _channels(self) -> Channels:
        assert self.observations.tilt is not None
        flat = self.observations.tilt.reshape(len(self.observations), -1)
        return Channels.from_sessions(~np.isnan(flat), self.observations.session)

    def _raw(self, prediction: Prediction) -> Floats:
        tilt = self.observations.tilt
        assert tilt is not None
        turned = prediction.joints[:, : self._places, TURNED]
        return np.asarray((tilt - turned).reshape(len(tilt), -1))
