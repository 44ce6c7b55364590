"""Exponential settling of the base or of the instrument: after start-up, after a move, after the sun comes in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import BASE, TWIST, Derivative, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.law_of_time import LawOfTime, settled_share, span_of_clock, time_constants
from kilter_core.effects.physical import STATION, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

USUAL = 0.2  # of the campaign, when no time constant is given


@dataclass(frozen=True)
class Settling(LawOfTime):
    """The base frame moves by a twist times 1 − exp(−(t − t0)/τ), in its own axes.

    ``tau_s`` is τ, a fifth of the rows' time when not given; a gap job tries several. ``t0_s`` is when the base is
    where the geometry says; without it the first row's time, once rows are known.
    """

    id = "settling"
    summary = "base or instrument settles exponentially"
    physical = STATION
    separated_by = (Separator.ORDER, Separator.SENSOR)
    source = "ISO 230-3, thermal distortion after start-up: first-order response; ISO 9283, drift"
    stage = "base"
    aliases = ("drift", "random_walk", "zero_drift", "session_shift")
    remedy = "revisit a reference pose often at the beginning, and let robot and instrument warm up first"
    at_joints = False

    tau_s: float | None = option(None, "Time constant, s, above 0; null: a fifth of the rows' time.", above=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tau_s is not None and not self.tau_s > 0.0:
            raise OptionError(f"settling has tau_s {self.tau_s!r}: give a time in s above 0.", effect=self.id)

    @classmethod
    def candidate_configurations(cls, robot: Robot, rows: Observations) -> Sequence[Mapping[str, Any]]:
        """At several paces, where rows have a time."""
        if rows.t is None or not len(rows):
            return super().candidate_configurations(robot, rows)
        return [{"tau_s": tau} for tau in time_constants(float(np.ptp(rows.t)))]

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Start at the earliest row, with a time constant in proportion to the rows' time."""
        law = super().configure_for_robot(robot, rows)
        if law.tau_s is not None or rows is None or rows.t is None or not len(rows):
            return law
        first, last = span_of_clock(rows.t)
        return replace(law, tau_s=time_constants(last - first, (USUAL,))[0])

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """What is left to settle at t0 along x, y, z, m, and about them, rad; named with τ, for a model may have several.

        Raises:
            OptionError: no time constant, and no rows to take it from.

        """
        if self.tau_s is None:
            raise OptionError(
                "settling needs tau_s: give the time constant in s, or rows with t_s to take it from.", effect=self.id
            )
        stem = f"settling_{self.tau_s:g}s"
        return tuple(
            Parameter(f"{stem}_{k}", unit, 0.0, 2e-4, -5e-3, 5e-3, f"settling of the base's {k}") for k, unit in TWIST
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the base and its derivatives by the amounts."""
        if self.tau_s is None:
            raise OptionError("settling needs tau_s: give its time constant in s.", effect=self.id)
        settled = settled_share(self.elapsed_time(batch), self.tau_s)
        moved = np.eye(6)[:, None, :] * settled[:, None]
        return linear(batch, values, [Derivative(k, BASE, xi=xi) for k, xi in enumerate(moved)])
