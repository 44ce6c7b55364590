"""Inclinometers on the links: the rotation of each joint about the axes of its frame beyond its command, up to a constant.

A reading is that of the sensor behind the joint minus that of one before it. It separates clearance and tilting from a rotation
about the axis, which positions of the tool mix up. A sensor mounted again, in another session, has another zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.measurement.kind import Block
from kilter_core.measurement.referenced import Channels, Referenced, referenced
from kilter_core.model import Prediction
from kilter_core.model.prediction import JOINT_ROWS, TOOL_ROWS, TURNED
from kilter_core.types import Floats


@dataclass(frozen=True)
class Inclination(Referenced):
    """Rows with readings of inclinometers. ``anchor`` are the rows that say what they read at zero."""

    name = "inclination"
    summary = "inclinometers on the links"
    column = "tilt"

    def blocks(self, prediction: Prediction, J: Floats | None = None) -> tuple[Block, ...]:
        """Measured minus predicted rotation (N, 3 n, 1) rad, the mean of its session taken out."""
        columns = None
        if J is not None:
            joints = J[:, TOOL_ROWS:].reshape(len(J), -1, JOINT_ROWS, J.shape[2])
            columns = joints[:, :-1, TURNED].reshape(len(J), -1, J.shape[2])
        return referenced(self.name, self._channels, self._raw(prediction), columns)

    @property
    def _channels(self) -> Channels:
        assert self.observations.tilt is not None
        flat = self.observations.tilt.reshape(len(self.observations), -1)
        return Channels.of(~np.isnan(flat), self.observations.session)

    def _raw(self, prediction: Prediction) -> Floats:
        tilt = self.observations.tilt
        assert tilt is not None
        turned = prediction.joints[:, : tilt.shape[1], TURNED]
        return np.asarray((tilt - turned).reshape(len(tilt), -1))
