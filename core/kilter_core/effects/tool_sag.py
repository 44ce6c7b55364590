"""Sag of the tool, of a gripper or of a reflector's adapter, under what the tool carries."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kilter_core.arm.robot import STANDARD_GRAVITY, Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import TOOL_SAG, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.transforms import rotation_along
from kilter_core.types import Floats


@dataclass(frozen=True)
class ToolSag(Effect):
    """The tool moves, without rotation, by s F/g across its axis: F is the weight of the payload, g standard gravity.

    ``axis`` is the tool's z in the frame of the last joint, from the robot: along it the adapter is stiff. The force is
    the one on the end of the last link, so it holds inertia and measured forces where the rows have them.
    """

    id = "tool_sag"
    summary = "tool or adapter sags under the payload"
    physical = TOOL_SAG
    separated_by = (Separator.LOADS,)
    source = "Euler-Bernoulli cantilever, deflection of its end in proportion to the load"
    needs = frozenset({"moments", "payload_kg"})
    signs = "positive"
    aliases = ("link_bending", "radial_compliance", "axial_compliance")
    remedy = "measure two loads with the tool pointing sideways and down, or a reflector on the flange besides"
    at_joints = False
    reads = (("end_wrench", (0, 1, 2)),)

    axis: tuple[float, ...] | None = option(
        None, "The tool's z in the frame of the last joint, along which nothing sags; null: from the robot."
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.axis is not None and (len(self.axis) != 3 or not np.linalg.norm(self.axis) > 0.0):
            raise OptionError(f"tool_sag has axis {self.axis!r}: give three numbers, not all 0.", effect=self.id)

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Find the tool's axis in the frame of the last joint."""
        if self.axis is not None:
            return self
        return replace(self, axis=tuple(float(x) for x in _tool_axis(robot)))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Sag s of the tool per kilogram, m/kg."""
        return (Parameter("sag_per_kg", "m/kg", 0.0, 1e-4, 0.0, 2e-3, "sag of the tool per kilogram of payload"),)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Shift behind the last joint, and its derivative by s."""
        carried = np.asarray(self.column(batch, "payload_kg"), dtype=np.float64) > 0.0
        xi = np.zeros((len(batch), 6))
        xi[:, :3] = carried[:, None] * (batch.end_wrench[:, -1, :3] @ sagging(self.axis or (0.0, 0.0, 1.0)))
        return linear(batch, values, [Derivative(0, batch.q.shape[1] - 1, xi=xi)])

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the sag behind the last joint by the load on the end of its link, where a payload hangs."""
        if form.conditions.payload_kg == 0.0:
            return True
        moved = np.zeros((6, 6))
        moved[:3, :3] = float(values[0]) * sagging(self.axis or (0.0, 0.0, 1.0)).T
        form.bend(len(form.joints) - 1, np.zeros((6, 6)), moved, np.zeros(3))
        return True


def sagging(axis: tuple[float, ...]) -> Floats:
    """Matrix (3, 3) that makes of a force N on the tool its share across the ``axis``, in kilograms."""
    u = np.asarray(axis, dtype=np.float64)
    u = u / np.linalg.norm(u)
    return np.asarray((np.eye(3) - np.outer(u, u)) / STANDARD_GRAVITY)


def _tool_axis(robot: Robot) -> Floats:
    """z of the tool frame (3,) in the frame of the last joint: through the constants between them."""
    chain = robot.chain
    turn = chain.program.joint_frame[-1].T
    for e in chain.elements[chain.primary[-1] + 1 :]:
        if e.axis.rotates and e.joint is None:
            turn = turn @ rotation_along(e.axis % 3, e.value)
    return np.asarray(turn @ robot.T_tool[:3, 2])
