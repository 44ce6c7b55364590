"""Base or instrument that moved once: a station that was knocked, an arm whose bolts slipped."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import BASE, Batch, Derivative, Effect, Local, linear, option
from kilter_core.effects.physical import STATION
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

TWIST = (("x", "m"), ("y", "m"), ("z", "m"), ("rx", "rad"), ("ry", "rad"), ("rz", "rad"))


@dataclass(frozen=True)
class BaseStep(Effect):
    """The base frame moved by a twist between two rows, in its own axes.

    Rows before ``at_s``, on their clock, or before ``at_row`` where no time is known, have the old place; all others,
    and rows of other days that say neither, have the new one, which is that of the geometry. A gap search places it.
    """

    id = "base_step"
    summary = "base or instrument moved once, between two rows"
    physical = STATION
    source = "Quandt 1958; Bai and Perron 1998: a linear model whose parameters change at an unknown row"
    stage = "base"
    aliases = ("drift", "settling", "random_walk", "zero_step")
    remedy = "give the rows before and after it a session each, and let every session have a base of its own"
    at_joints = False
    glances = frozenset({"t", "row"})
    event = True

    at_s: float | None = option(None, "When it happened, s on the clock of the rows.")
    at_row: int | None = option(None, "First row after it, counted from 1 as measured.")

    def on(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Put it in the middle of the rows where nothing says when it happened."""
        if rows is None or not len(rows) or self.at_s is not None or self.at_row is not None:
            return self
        if rows.t is not None:
            return replace(self, at_s=float(np.median(rows.t)))
        return self if rows.row is None else replace(self, at_row=int(np.median(rows.row)))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """How far it moved along x, y, z, m, then about them, rad."""
        return tuple(
            Parameter(f"step_base_{k}", unit, 0.0, 5e-3, -0.1, 0.1, f"how far the base moved: its {k}")
            for k, unit in TWIST
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the base and its derivatives by how far it moved."""
        before = -batch.before(self.at_s, self.at_row)
        moved = np.eye(6)[:, None, :] * before[:, None]
        return linear(batch, values, [Derivative(k, BASE, xi=xi) for k, xi in enumerate(moved)])

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add nothing: what moves now does so after it."""
        return True
