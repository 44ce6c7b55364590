"""Channels that are known up to a constant: encoders on the links, and inclinometers.

A reading is that of the sensor behind the joint minus that of one before it. It separates clearance and tilting from a rotation
about the axis, which positions of the tool mix up. A sensor on the base reads how that rotates about the axes of the base
frame, which tells a mount that deflects from the first joints. A sensor mounted again, in another session, has another zero.

They see what happens between motor and link and nothing else: not the lengths of the links, and no tilt of a joint. Beside
tool data they tell what the tool alone mixes up. An encoder is referenced again in every session, so its zero is taken out
of each: only differences count.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self, cast

import numpy as np

from kilter_core.measurement.kind import Block, Kind, Rows, find_anchor
from kilter_core.model import Calibration, Prediction
from kilter_core.model.prediction import ABOUT, JOINT_ROWS, TOOL_ROWS, TURNED
from kilter_core.observations import Observations
from kilter_core.types import Bools, Floats, Ints


@dataclass(frozen=True)
class Channels:
    """Which numbers of N rows and C channels were ``seen (N, C)``, and the ``series (N,)`` whose zeros are their own."""

    seen: Bools
    series: Ints

    @staticmethod
    def from_sessions(seen: Bools, session: Ints | None) -> Channels:
        """Sessions are series; rows without are of one."""
        return Channels(seen, np.zeros(len(seen), dtype=np.int64) if session is None else session)

    @property
    def scalars(self) -> int:
        """Numbers seen, less one zero for each channel and series that has any."""
        return int(self.seen.sum() - sum(self.seen[self.series == s].any(axis=0).sum() for s in np.unique(self.series)))

    def subtract_series_means(self, values: Floats) -> Floats:
        """Values (N, C, ...) less the mean of their channel and series; NaN where nothing was seen."""
        return np.where(_wide(self.seen, values), values - self._means(values)[1][self._place], np.nan)

    def from_zeros(self, values: Floats, other: Channels, before: Floats) -> Floats:
        """Values (N, C) less the zeros that other rows, ``before (M, C)``, say; their own where a series is new."""
        names, zeros = other._means(before)
        own = self._means(values)[1][self._place]
        known = {int(s): zeros[k] for k, s in enumerate(names)}
        told = np.array([known.get(int(s), np.full(values.shape[1], np.nan)) for s in self.series])
        return np.where(self.seen, values - np.where(np.isnan(told), own, told), np.nan)

    @property
    def _place(self) -> Ints:
        return np.unique(self.series, return_inverse=True)[1].reshape(-1)

    def _means(self, values: Floats) -> tuple[Ints, Floats]:
        """Series (S,) and means (S, C, ...), NaN of a channel that has nothing in a series."""
        names, place = np.unique(self.series, return_inverse=True)
        sums = np.zeros((len(names), *values.shape[1:]))
        count = np.zeros((len(names), self.seen.shape[1]))
        np.add.at(sums, place.reshape(-1), np.where(_wide(self.seen, values), values, 0.0))
        np.add.at(count, place.reshape(-1), self.seen)
        with np.errstate(invalid="ignore"):
            return names, np.asarray(sums / _wide(count, sums))


@dataclass(frozen=True)
class Referenced(Kind):
    """A kind whose readings are known up to a constant. ``anchor`` are the rows that say what they read at zero."""

    unit = "rad"
    column: ClassVar[str]  # of the observations, that the kind reads

    observations: Observations
    anchor: Self | None = None

    @classmethod
    def from_rows(cls, rows: Rows) -> Self | None:
        """Rows that have the column."""
        if getattr(rows.observations, cls.column) is None:
            return None
        return cls(rows.observations, cast("Self | None", find_anchor(cls.name, rows)))

    @property
    @abstractmethod
    def _channels(self) -> Channels:
        """What was read."""

    @abstractmethod
    def _raw(self, prediction: Prediction) -> Floats:
        """Measured minus predicted (N, C), the zeros left in."""

    @property
    def reads_joints(self) -> bool:
        """Yes."""
        return True

    def measured_row_mask(self) -> Bools:
        """Rows that have a reading."""
        return np.asarray(self._channels.seen.any(axis=1))

    def scalars(self) -> int:
        """Readings beyond those that the zeros take."""
        return self._channels.scalars

    def errors(self, calibration: Calibration) -> tuple[Floats, Floats | None]:
        """Errors (K, 1) rad, from what the sensors of the anchor read at zero."""
        left = self._raw(calibration.predict(self.observations))
        if self.anchor is not None:
            before = self.anchor._raw(calibration.predict(self.anchor.observations))
            left = self._channels.from_zeros(left, self.anchor._channels, before)
        else:
            left = self._channels.subtract_series_means(left)
        return left[np.isfinite(left)][:, None], None


def offset_free_blocks(
    group: str, channels: Channels, left: Floats, columns: Floats | None, lengths: Bools | None = None
) -> tuple[Block, ...]:
    """Blocks of residuals (N, C) and columns (N, C, P) whose zeros are taken out; channels of ``lengths (C,)`` m apart."""
    r = channels.subtract_series_means(left)[:, :, None]
    J = None if columns is None else np.nan_to_num(channels.subtract_series_means(columns))[:, :, None, :]
    if lengths is None or not lengths.any():
        return (Block(group, r, J, "rad"),)
    parts = ((~lengths, group, "rad"), (lengths, f"{group}_m", "m"))
    return tuple(
        Block(name, r[:, own], None if J is None else J[:, own], "m" if unit == "m" else "rad")
        for own, name, unit in parts
        if own.any()
    )


def _wide(flags: Floats | Bools, like: Floats) -> Floats:
    """Flags (N, C) with as many axes as the values they are of."""
    return np.asarray(flags.reshape(flags.shape + (1,) * (like.ndim - 2)))


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
