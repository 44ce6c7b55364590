"""Tool or marker that moved once: a reflector remounted, a nest exchanged, a tool that hit something."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import TOOL, Derivative, Local, linear
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import TOOL_SHIFT
from kilter_core.effects.step import Step
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class ToolStep(Step):
    """The tool point moved between two rows, along the axes of the tool."""

    id = "tool_step"
    summary = "tool, marker or nest moved once, between two rows"
    physical = TOOL_SHIFT
    stage = "measurement"
    aliases = ("session_shift", "base_step")
    remedy = "give the rows before and after it a session each, and search for session_shift"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """How far it moved along x, y, z of the tool frame, m."""
        return tuple(
            Parameter(f"step_tool_{k}", "m", 0.0, 5e-3, -0.1, 0.1, f"how far the tool moved along {k}") for k in "xyz"
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Shift of the tool and its derivatives by how far it moved."""
        before = -batch.before(self.at_s, self.at_row)
        moved = np.eye(6)[:3, None, :] * before[:, None]
        return linear(batch, values, [Derivative(k, TOOL, xi=xi) for k, xi in enumerate(moved)])
