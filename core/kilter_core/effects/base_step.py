"""Base or instrument that moved once: a station that was knocked, an arm whose bolts slipped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import BASE, TWIST, Derivative, Local, linear
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import STATION
from kilter_core.effects.step import Step
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class BaseStep(Step):
    """The base frame moved by a twist between two rows, in its own axes."""

    id = "base_step"
    summary = "base or instrument moved once, between two rows"
    physical = STATION
    stage = "base"
    aliases = ("drift", "settling", "random_walk", "zero_step")
    remedy = "give the rows before and after it a session each, and let every session have a base of its own"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """How far it moved along x, y, z, m, then about them, rad."""
        return tuple(
            Parameter(f"step_base_{k}", unit, 0.0, 5e-3, -0.1, 0.1, f"how far the base moved: its {k}")
            for k, unit in TWIST
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the base and its derivatives by how far it moved."""
        before = -batch.before_event_indicator(self.at_s, self.at_row)
        moved = np.eye(6)[:, None, :] * before[:, None]
        return linear(batch, values, [Derivative(k, BASE, xi=xi) for k, xi in enumerate(moved)])

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add nothing: what moves now does so after it."""
        return True
