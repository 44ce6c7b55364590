"""Channels that are known up to a constant: encoders and inclinometers, whose zeros are taken out session by session.

A zero is linear, so taking the mean out of residuals and Jacobian is what fitting it beside the parameters would do.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self, cast

import numpy as np

from kilter_core.measurement.kind import Block, Kind, Rows, find_anchor
from kilter_core.model import Calibration, Prediction
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
