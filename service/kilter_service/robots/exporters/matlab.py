"""A version as a MATLAB function that builds a ``rigidBodyTree`` (Robotics System Toolbox)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from kilter_core.arm import joint_frames
from kilter_core.model import flange_screws, wanted_tool
from kilter_core.types import Floats
from kilter_service.robots.exporters.exportable import Exportable, Written, omissions
from kilter_service.robots.exporters.registry import program_name

if TYPE_CHECKING:
    from kilter_core.arm import Joint


def matlab(version: Exportable) -> Written:
    """Write the function; joints are in rad and m, as MATLAB has them.

    Raises:
        RobotError: a joint drives several axes, which a rigidBodyTree cannot.

    """
    calibration = version.calibration
    screws = flange_screws(calibration).one_axis_per_joint()
    frames, notes = joint_frames(screws), omissions(calibration)
    name = program_name(f"{version.version.robot}-{version.version.id}")
    lines = [f"function robot = {name}()"]
    lines += [f"% Robot {version.version.robot} as calibrated by Kilter, version {version.version.id}."]
    lines += [f"% {note}" for note in notes]
    lines += ["robot = rigidBodyTree('DataFormat', 'row');"]
    lines += [f"robot.Gravity = {_row(calibration.robot.gravity)};"]
    parent = "base"
    for joint, origin in zip(calibration.robot.joints, frames.origin, strict=True):
        lines += _body(joint.name, joint.kind, parent, origin, list(_of_joint(joint)))
        parent = joint.name
    lines += _body("flange", "fixed", parent, frames.end, [])
    lines += _body("tool", "fixed", "flange", wanted_tool(calibration), [])
    return Written("\n".join([*lines, "end", ""]), notes)


def _body(name: str, kind: str, parent: str, origin: Floats, settings: list[str]) -> list[str]:
    quoted, above = name.replace("'", "''"), parent.replace("'", "''")
    return [
        f"body = rigidBody('{quoted}');",
        f"joint = rigidBodyJoint('{quoted}', '{kind}');",
        *settings,
        f"setFixedTransform(joint, [{'; '.join(_numbers(row) for row in origin)}]);",
        "body.Joint = joint;",
        f"addBody(robot, body, '{above}');",
    ]


def _of_joint(joint: Joint) -> Iterator[str]:
    yield "joint.JointAxis = [0 0 1];"
    if math.isfinite(joint.lower) and math.isfinite(joint.upper):
        yield f"joint.PositionLimits = {_row(np.array([joint.lower, joint.upper]))};"


def _row(values: Floats) -> str:
    return f"[{_numbers(values)}]"


def _numbers(values: Floats) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)
