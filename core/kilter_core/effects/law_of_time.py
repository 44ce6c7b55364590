"""Laws of time: on which clock they run, and which rows they reach."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import Effect, option
from kilter_core.effects.batch import Batch
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.observations.clock import applicable_time_mask, on_shared_clock
from kilter_core.types import Floats

SHARES = (0.07, 0.14, 0.27, 0.52)  # time constants, of the campaign: nearer ones look the same


@dataclass(frozen=True)
class LawOfTime(Effect):
    """Something moves with the time since ``t0_s``, when all is where the geometry says.

    It holds on its own clock, from half a day before ``t0_s`` to half a day after ``until_s``. In other rows the geometry
    holds alone. Laws of earlier releases have no ``until_s`` and hold on their whole clock.
    """

    needs = frozenset({"t"})
    clock = "t"

    t0_s: float | None = option(None, "When it began, s on the clock of the rows; null: the earliest row.")
    until_s: float | None = option(
        None, "Last time that it was fitted to, s: half a day later it is not applied; null: the last row."
    )

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Begin at the earliest row and end at the last one."""
        if rows is None or rows.t is None or not len(rows):
            return self
        begin, end = span_of_clock(rows.t)
        return replace(
            self,
            t0_s=begin if self.t0_s is None else self.t0_s,
            until_s=end if self.until_s is None else self.until_s,
        )

    @property
    def time_span(self) -> tuple[float, float | None] | None:
        """When it begins and ends, s."""
        return None if self.t0_s is None else (self.t0_s, self.until_s)

    def elapsed_time(self, batch: Batch) -> Floats:
        """Return the time (N,) s since the law began; 0 in rows that it does not reach.

        Raises:
            OptionError: nobody said when it began.

        """
        t = np.asarray(self.column(batch, "t"), dtype=np.float64)
        if self.t0_s is None:
            raise OptionError(f"{self.id} needs t0_s: give the time in s at which it began.", effect=self.id)
        return np.where(applicable_time_mask(t, self.t0_s, self.until_s), t - self.t0_s, 0.0)


def settled_share(elapsed: Floats, tau_s: float) -> Floats:
    """Return 1 − exp(−t/τ) (N,) of rows ``elapsed`` t s after the beginning; 0 before it."""
    return np.asarray(-np.expm1(-np.maximum(elapsed, 0.0) / tau_s))


def time_constants(span_s: float, shares: tuple[float, ...] = SHARES) -> tuple[float, ...]:
    """Return time constants s for rows over ``span_s``, in two digits, so that names of parameters stay short."""
    found = (float(f"{share * span_s:.2g}") for share in shares)
    return tuple(dict.fromkeys(tau if tau > 0.0 else 1.0 for tau in found))


def span_of_clock(t: Floats) -> tuple[float, float]:
    """Return the first and last time (s) of rows; of those on the shared clock alone where rows are on several."""
    shared = on_shared_clock(t)
    own = t[shared] if shared.any() else t
    return float(np.min(own)), float(np.max(own))
