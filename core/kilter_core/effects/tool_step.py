"""What is on the flange that moved once: a tool that hit something, a marker remounted, a camera or board bumped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import TOOL, TWIST, Derivative, Local, linear
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import TOOL_SHIFT
from kilter_core.effects.step import Step
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class ToolStep(Step):
    """The tool frame moved by a twist between two rows, in its own axes.

    Points of one reflector show no rotation about it.
    """

    id = "tool_step"
    summary = "tool, marker or nest moved once, between two rows"
    physical = TOOL_SHIFT
    stage = "measurement"
    aliases = ("session_shift", "base_step")
    remedy = "give the rows before and after it a session each, and let every session have a tool of its own"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """How far it moved along x, y, z of the tool frame, m, then about them, rad."""
        return tuple(
            Parameter(f"step_tool_{k}", unit, 0.0, 5e-3, -0.1, 0.1, f"how far the tool moved: its {k}")
            for k, unit in TWIST
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the tool and its derivatives by how far it moved."""
        before = -batch.before_event_indicator(self.at_s, self.at_row)
        moved = np.eye(6)[:, None, :] * before[:, None]
        return linear(batch, values, [Derivative(k, TOOL, xi=xi) for k, xi in enumerate(moved)])
