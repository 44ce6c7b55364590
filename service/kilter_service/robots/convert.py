"""A robot document in another convention: the same arm, for a fit or a program that needs that convention."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import indent, tostring

from kilter_service.contract.robots import RobotDocument
from kilter_service.ground.core import core_arm, core_model
from kilter_service.robots.documents import SETTINGS, core_document
from kilter_service.robots.exporters.urdf_new import new_urdf

if TYPE_CHECKING:
    from kilter_core.arm import Robot


def convert(document: RobotDocument, to: str) -> dict[str, Any]:
    """Return the document of the same arm in convention ``to``.

    Raises:
        RobotError: not an arm, or one the convention cannot describe. OptionError: no such convention.

    """
    posted = document.model_dump(mode="json", exclude_none=True)
    robot = core_arm.robot_from_document(core_document(posted).document)
    made = _urdf(robot) if to == "urdf" else core_arm.robot_document(robot, to)
    return made | {key: posted[key] for key in ("source", *SETTINGS) if key in posted}


def _urdf(robot: Robot) -> dict[str, Any]:
    root = new_urdf(robot.name, core_model.Calibration.nominal(robot))
    indent(root)
    driven = [{"name": joint.name, **told} for joint in robot.joints if (told := core_arm.drive_document(joint))]
    return (
        {
            "name": robot.name,
            "convention": "urdf",
            "urdf": '<?xml version="1.0"?>\n' + tostring(root, encoding="unicode") + "\n",
            "base_link": "base_link",
            "tip_link": "flange",
            "gravity_m_s2": robot.gravity.tolist(),
            "base": core_arm.pose_document(robot.T_base),
            "tool": core_arm.pose_document(robot.T_tool),
        }
        | core_arm.load_document(robot)
        | ({"joints": driven} if driven else {})
    )
