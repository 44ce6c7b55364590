"""Where loads are taken: the chain and the tool frame at which the weight of links and payload is computed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.arm.chain import Chain
from kilter_core.arm.robot import Robot
from kilter_core.parameters import indices
from kilter_core.transforms import rotation_log
from kilter_core.types import Floats

AT_THE_TOOL_M = 0.010  # a fitted tool frame within this of the robot's own is the tool that the payload hangs on;
AT_THE_TOOL_RAD = np.radians(1.0)  # farther off it is where the target sits, and the payload stays where it was stated


@dataclass(frozen=True)
class LoadChain:
    """Chain constants ``values (K,)``, those with a name in their order, and ``T_tool (4, 4)`` at which loads are computed.

    They are constants of a model, not its parameters: a fit holds them still, so the model stays exact in its parameters,
    and they are updated between fits. Gravity stays as the robot states it, in the axes of its base frame, the origin of
    the chain: the frame of the measurements has no level, so what is fitted between the two says nothing of the vertical.
    What a fitted base takes up of the first joint's zero rotates no load about a vertical first axis; of an arm on a wall it
    stays out of the loads.

    ``effects`` are the parameters of effects by name at which the arm deflects: an arm that sags carries its weights at
    other levers, an error of its sag that grows with the square of it. Without them loads are taken at the joint readings.
    What tilts the base as a whole is left out of it: gravity stays as the robot states it.
    """

    values: Floats
    T_tool: Floats
    effects: Mapping[str, float] | None = None

    @staticmethod
    def from_fitted_values(
        robot: Robot, values: Floats, T_tool: Floats, effects: Mapping[str, float] | None = None
    ) -> LoadChain:
        """At these constants (K,), and under the tool frame where it is the robot's own but for its errors."""
        own = robot.T_tool
        apart = float(np.linalg.norm(own[:3, 3] - T_tool[:3, 3]))
        turned = float(np.linalg.norm(rotation_log((own[:3, :3].T @ T_tool[:3, :3])[None])))
        near = apart < AT_THE_TOOL_M and turned < AT_THE_TOOL_RAD
        return LoadChain(values.copy(), T_tool if near else own, effects)

    def apply_to_robot(self, robot: Robot) -> Robot:
        """The robot with these constants and this tool: what loads are computed from."""
        elements = list(robot.chain.elements)
        for k, value in zip(robot.chain.named_elements, self.values.tolist(), strict=True):
            elements[k] = replace(elements[k], value=value)
        return replace(robot, chain=Chain(tuple(elements), robot.n_joints), T_tool=self.T_tool)

    def to_document(self, robot: Robot) -> dict[str, Any]:
        """JSON-able state, SI: constants by name, tool frame, and by name what deflects where anything does."""
        document = {
            "values": dict(zip(_names(robot), self.values.tolist(), strict=True)),
            "T_tool": self.T_tool.tolist(),
        }
        return document if self.effects is None else document | {"effects": dict(self.effects)}

    @staticmethod
    def from_document(robot: Robot, document: Mapping[str, Any] | None) -> LoadChain | None:
        """Rebuild from :meth:`to_document`; None, the nominal chain, where a version has none.

        Raises:
            OptionError: a constant that the robot does not have.

        """
        if document is None:
            return None
        elements = robot.chain.elements
        values = np.array([elements[k].value for k in robot.chain.named_elements], dtype=np.float64)
        stored = document["values"]
        values[indices(_names(robot), stored)] = list(stored.values())
        effects = document.get("effects")  # earlier versions have none: their loads are at the readings
        return LoadChain(values, np.array(document["T_tool"], dtype=np.float64), effects)


def _names(robot: Robot) -> list[str]:
    return [robot.chain.elements[k].name or "" for k in robot.chain.named_elements]
