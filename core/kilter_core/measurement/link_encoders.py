"""Encoders on the links: the angle of each joint behind gear and backlash, up to a constant that belongs to the encoder.

They see what happens between motor and link and nothing else: not the lengths of the links, and no tilt of a joint. Beside
tool data they tell what the tool alone mixes up. An encoder is referenced again in every session, so its zero is taken out
of each: only differences count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.measurement.kind import Block
from kilter_core.measurement.referenced import Channels, Referenced, offset_free_blocks
from kilter_core.model import Prediction
from kilter_core.model.prediction import ABOUT, JOINT_ROWS, TOOL_ROWS
from kilter_core.types import Bools, Floats

STILL = 1e-6  # rad or m: a channel whose readings stay within this is dead


@dataclass(frozen=True)
class LinkEncoders(Referenced):
    """Rows with link-side angles beside the motors'. ``anchor`` are the rows that say what the encoders read at zero."""

    name = "link_encoders"
    summary = "encoders on the links, behind gear and backlash"
    column = "link_q"

    @property
    def live(self) -> Bools:
        """Joints (n,) whose encoder moves; a constant one is a dead channel."""
        link = self.observations.link_q
        assert link is not None
        high, low = np.nan_to_num(link, nan=-np.inf).max(axis=0), np.nan_to_num(link, nan=np.inf).min(axis=0)
        return np.asarray(high - low > STILL)

    def blocks(self, prediction: Prediction, J: Floats | None = None) -> tuple[Block, ...]:
        """Measured minus predicted angle (N, n, 1) rad of each joint, the mean of its session taken out; of prismatic
        joints apart, m.
        """
        return offset_free_blocks(self.name, self._channels, self._raw(prediction), _columns(J), prediction.slides)

    @property
    def _channels(self) -> Channels:
        link, session = self.observations.link_q, self.observations.session
        assert link is not None
        return Channels.from_sessions(~np.isnan(link) & self.live, session)

    def _raw(self, prediction: Prediction) -> Floats:
        link = self.observations.link_q
        assert link is not None
        return np.asarray(link - self.observations.q - prediction.joints[:, : link.shape[1], ABOUT])


def _columns(J: Floats | None) -> Floats | None:
    if J is None:
        return None
    joints = J[:, TOOL_ROWS:].reshape(len(J), -1, JOINT_ROWS, J.shape[2])
    return np.asarray(joints[:, :-1, ABOUT])
