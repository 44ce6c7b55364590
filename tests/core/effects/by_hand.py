"""Small arms drawn by hand, and arms with small motions put in by hand: nothing of the effects is used."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Robot
from kilter_core.effects import Effect, make_effect
from kilter_core.model import Prediction, RobotModel
from kilter_core.observations import Observations
from tests.core.truth import JOINT_FRAME, Arm, Body, Step

Floats = NDArray[np.float64]
G = 9.80665


def one_joint(
    axis: str, *, length: float = 1.0, mass: float = 0.0, tool: tuple[float, float, float] = (0, 0, 0)
) -> Arm:
    """One joint at the origin, a link of ``length`` along x with a mass at its end, and a tool beyond it."""
    steps = (Step(axis, 0.0, 0, name="q"), Step("tx", length, name="a"))
    bodies = (Body(0, mass, np.array([length, 0.0, 0.0])),) if mass else ()
    return Arm(steps, 1, tool=pin.SE3(np.eye(3), np.array(tool, dtype=np.float64)), bodies=bodies)


def robot_of(arm: Arm) -> Robot:
    """The arm as the core sees it."""
    return robot_from_document(arm.document())


def effect_on(arm: Arm, effect_id: str, rows: Observations | None = None, **config: Any) -> Effect:
    """An effect completed for the arm."""
    return make_effect(effect_id, **config).configure_for_robot(robot_of(arm), rows)


def tool_with(arm: Arm, effect: Effect, values: Mapping[str, float], rows: Observations) -> Prediction:
    """Tool poses of the core's model with these effect values; those not named are zero."""
    model = RobotModel(robot_of(arm), (effect,))
    whole = model.values0()
    for name, value in values.items():
        whole[model.names.index(name)] = value
    return model.predict(rows, whole)


def inserted(
    arm: Arm,
    q: Floats,
    joints: Mapping[int, Floats] | None = None,
    base: Floats | None = None,
    tool: Floats | None = None,
) -> Any:
    """Tool pose (SE3) of a row with exp of twists (v, w): in the joint frames, after base, on the tool."""
    pose = arm.base * pin.exp6(np.zeros(6) if base is None else base)
    carrier = {arm.first_of(j): j for j in range(arm.n)}
    moving = 0
    for step in arm.steps:
        if step.joint is None:
            pose = pose * step.motion()
            continue
        amount = step.ratio * q[step.joint] + step.value
        pose = pose * Step(step.axis, amount).motion()
        j = carrier.get(moving)
        moving += 1
        if j is not None and joints is not None and j in joints:
            frame = JOINT_FRAME[step.axis[1]] @ (np.diag([1.0, -1.0, -1.0]) if step.ratio < 0 else np.eye(3))
            turned = np.concatenate([frame @ joints[j][:3], frame @ joints[j][3:]])
            pose = pose * pin.exp6(turned)
    return pose * arm.tool * pin.exp6(np.zeros(6) if tool is None else tool)
