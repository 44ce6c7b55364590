"""Curves of a joint by its own angle that hold where they were measured. Shared by effects; none itself."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Effect, Local, option
from kilter_core.effects.batch import Batch
from kilter_core.errors import OptionError
from kilter_core.types import Floats

FADE = float(np.radians(10.0))  # beyond its range in which a curve fades, rad
MEAN_OF = 200  # angles of the range over which its mean is taken
TURN = 2.0 * np.pi
KNOWN = np.pi  # range of a joint from which on its waves are known at every angle: half a revolution


@dataclass(frozen=True)
class JointCurve(Effect):
    """An error of a joint that follows its own angle alone.

    With ``measured`` it holds in that range. Beyond it nobody knows its shape: within ``FADE`` it fades to its mean over
    the range, which the zero of the joint takes up where it is fitted without the curve.
    """

    measured: tuple[tuple[float, float], ...] | None = option(
        None, "Range of each joint, rad, beyond which the curve fades to its mean; null: it holds at every angle."
    )

    @abstractmethod
    def signals(self, q: Floats) -> Sequence[Floats]:
        """Derivatives (N, n) of the joint's error by each amplitude of a joint, at joints ``q (N, n)``."""

    @abstractmethod
    def add_curves(self, form: RunTimeForm, values: Floats) -> None:
        """Add the curves as they are where they were measured."""

    def with_measured_range(self, q: Floats) -> Self:
        """The effect where rows ``q (N, n)`` measured it; over half a revolution or more it is known at every angle."""
        joints = self.acting(q.shape[1])
        low, high = q.min(axis=0), q.max(axis=0)
        turning = high - low >= KNOWN
        ends = np.where(turning, low - 10.0 * TURN, low), np.where(turning, high + 10.0 * TURN, high)
        return replace(self, measured=tuple((float(ends[0][j]), float(ends[1][j])) for j in joints))

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivatives by the amplitudes."""
        q = batch.q
        if self.measured is None:
            return self.joint_angle(batch, values, *self.signals(q))
        low, high = self._ends(q.shape[1])
        inside = np.clip(q, low, high)
        beyond = np.minimum(np.abs(q - inside) / FADE, 1.0)
        kept = 1.0 - beyond**2 * (3.0 - 2.0 * beyond)
        pairs = zip(self.signals(inside), self._means(q.shape[1]), strict=True)
        return self.joint_angle(batch, values, *(mean + kept * (signal - mean) for signal, mean in pairs))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the curves, within their range where one is stated."""
        first, n = len(form.curves), len(form.joints)
        self.add_curves(form, values)
        if self.measured is not None:
            joints, means = self.acting(n), self._means(n)
            amplitudes = values.reshape(len(means), len(joints))
            for place, (joint, ends) in enumerate(zip(joints, self.measured, strict=True)):
                mean = sum(float(a) * float(m[joint]) for a, m in zip(amplitudes[:, place], means, strict=True))
                form.bound_curves(first, joint, ends, FADE, mean)
        return True

    def _ends(self, n: int) -> tuple[Floats, Floats]:
        low, high, joints, ranges = np.zeros(n), np.zeros(n), self.acting(n), self.measured or ()
        if len(ranges) != len(joints) or any(len(ends) != 2 or ends[0] > ends[1] for ends in ranges):
            raise OptionError(
                f"{self.id} has measured {ranges!r}: give lowest and highest of {len(joints)} joints.", effect=self.id
            )
        for joint, ends in zip(joints, ranges, strict=True):
            low[joint], high[joint] = ends
        return low, high

    def _means(self, n: int) -> list[Floats]:
        """Mean (n,) of each signal over the range of each joint."""
        low, high = self._ends(n)
        share = (np.arange(MEAN_OF)[:, None] + 0.5) / MEAN_OF
        return [np.asarray(signal.mean(axis=0)) for signal in self.signals(low + share * (high - low))]
