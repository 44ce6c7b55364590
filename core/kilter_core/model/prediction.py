"""What a model predicts of rows: where the tool is, and what its joints rotate by."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.effects import Effect
from kilter_core.model.chain_rule import Total
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.types import Bools, Floats, Ints

NOTHING = np.zeros(0, dtype=np.int64)  # no parameter
TOOL_ROWS = 6  # of a Jacobian: position, then rotation vector of the tool
JOINT_ROWS = 4  # of each joint behind them: correction of its angle, then its rotation about x, y and z of its frame
ABOUT, TURNED = 0, slice(1, 4)  # places of these among the four


@dataclass(frozen=True)
class Instrument:
    """Cameras and boards as they stand, and the ``columns (K,)`` of the Jacobian that their unknowns have, -1 for none."""

    rig: PlacedRig
    columns: Ints


def find_instrument(placed: Iterable[tuple[Effect, slice]], values: Floats, free: Ints = NOTHING) -> Instrument | None:
    """The cameras among effects and where their ``values`` are, and the columns they have in a Jacobian by ``free``."""
    for effect, at in placed:
        if effect.instrument is not None:
            columns = np.full(at.stop - at.start, -1, dtype=np.int64)
            own = np.flatnonzero((free >= at.start) & (free < at.stop))
            columns[free[own] - at.start] = own
            return Instrument(effect.instrument.with_values(values[at]), columns)
    return None


@dataclass(frozen=True)
class Prediction:
    """Tool ``position (N, 3)`` m and ``rotation (N, 3, 3)`` in the frame of the measurements.

    ``local`` are the corrections at the joints that it was made with, and ``slides (n,)`` marks prismatic joints.
    ``instrument`` is what is known of the cameras, None where nothing is.
    """

    position: Floats
    rotation: Floats
    local: Total | None = None
    slides: Bools | None = None
    instrument: Instrument | None = None

    def with_rig(self, rig: PlacedRig | None) -> Prediction:
        """The same with cameras that stand as a ``rig`` says, unless the prediction has its own."""
        if rig is None or self.instrument is not None:
            return self
        return replace(self, instrument=Instrument(rig, NOTHING))

    @property
    def joints(self) -> Floats:
        """What each joint, and last the base, rotates by beyond its command (N, n + 1, 4): see :data:`JOINT_ROWS`."""
        assert self.local is not None
        return self.local.joint_rotations()
