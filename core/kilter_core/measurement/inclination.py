"""Inclinometers on links and base: how each joint rotates about the axes of its frame beyond its command, up to a constant.

A reading is that of the sensor behind the joint minus that of one before it. It separates clearance and tilting from a rotation
about the axis, which positions of the tool mix up. A sensor on the base reads how that rotates about the axes of the base
frame, which tells a mount that deflects from the first joints. A sensor mounted again, in another session, has another zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from kilter_core.measurement.kind import Block, Kind, Rows, anchor_of
from kilter_core.measurement.referenced import Channels, referenced
from kilter_core.model import Calibration, Prediction
from kilter_core.model.prediction import JOINT_ROWS, TOOL_ROWS, TURNED
from kilter_core.observations import Observations
from kilter_core.types import Bools, Floats


@dataclass(frozen=True)
class Inclination(Kind):
    """Rows with readings of inclinometers. ``anchor`` are the rows that say what they read at zero."""

    name = "inclination"
    summary = "inclinometers on links and base"
    unit = "rad"

    observations: Observations
    anchor: Inclination | None = None

    @classmethod
    def of(cls, rows: Rows) -> Inclination | None:
        """Rows with columns of inclinometers."""
        if rows.observations.tilt is None:
            return None
        return cls(rows.observations, cast("Inclination | None", anchor_of(cls.name, rows)))

    @property
    def reads_joints(self) -> bool:
        """Yes."""
        return True

    def measured(self) -> Bools:
        """Rows that have a reading."""
        return np.asarray(self._channels.seen.any(axis=1))

    def scalars(self) -> int:
        """Readings beyond those that the zeros take."""
        return self._channels.scalars

    def blocks(self, prediction: Prediction, J: Floats | None = None) -> tuple[Block, ...]:
        """Measured minus predicted rotation (N, C, 1) rad, the mean of its session taken out: C is 3 n, or 3 n + 3 with
        the base.
        """
        columns = None
        if J is not None:
            joints = J[:, TOOL_ROWS:].reshape(len(J), -1, JOINT_ROWS, J.shape[2])
            columns = joints[:, : self._places, TURNED].reshape(len(J), -1, J.shape[2])
        return referenced(self.name, self._channels, self._raw(prediction), columns)

    def errors(self, calibration: Calibration) -> tuple[Floats, Floats | None]:
        """Errors (K, 1) rad, from what the sensors of the anchor read at zero."""
        left = self._raw(calibration.predict(self.observations))
        if self.anchor is not None:
            before = self.anchor._raw(calibration.predict(self.anchor.observations))
            left = self._channels.from_zeros(left, self.anchor._channels, before)
        else:
            left = self._channels.centred(left)
        return left[np.isfinite(left)][:, None], None

    @property
    def _places(self) -> int:
        """Joints, and the base where it has a column."""
        assert self.observations.tilt is not None
        return int(self.observations.tilt.shape[1])

    @property
    def _channels(self) -> Channels:
        assert self.observations.tilt is not None
        flat = self.observations.tilt.reshape(len(self.observations), -1)
        return Channels.of(~np.isnan(flat), self.observations.session)

    def _raw(self, prediction: Prediction) -> Floats:
        tilt = self.observations.tilt
        assert tilt is not None
        turned = prediction.joints[:, : self._places, TURNED]
        return np.asarray((tilt - turned).reshape(len(tilt), -1))
