"""A version as MJCF: bodies as identified, drives that deflect as the joints do, and a table for the rest."""

from __future__ import annotations

from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

from kilter_service.robots.exporters.exportable import Exportable, Written, numbers
from kilter_service.robots.exporters.mjcf.effects import drives, exported_effects, passive_joint_part
from kilter_service.robots.exporters.mjcf.notes import KNOWN_OF_MUJOCO, in_mujoco, notes, of_sharpened, table, twisting
from kilter_service.robots.exporters.mjcf.tree import bodies, nominal_frames

TABLE, NOMINAL = "kilter", "kilter_nominal"  # names of the text and of the numbers among <custom>
# Every release of MuJoCo since 2.3.3 has this integrator; what it needs of stiff gains is in drives.py.
OPTION = {"integrator": "implicitfast", "timestep": "0.002", "tolerance": "1e-14"}
COMPILER = {"angle": "radian", "boundmass": "1e-9", "boundinertia": "1e-9", "balanceinertia": "true"}


def mjcf(version: Exportable) -> Written:
    """Write the model; a comment at its head has what it cannot say.

    Raises:
        RobotError: a joint drives several axes.

    """
    calibration = version.calibration
    exported = exported_effects(calibration)
    driven = drives(exported.robot, [passive_joint_part(joint) for joint in exported.form.joints])
    written = notes(version.version, calibration, in_mujoco(exported), (*of_sharpened(exported), *KNOWN_OF_MUJOCO))
    root = Element("mujoco", model=f"{version.version.robot} {version.version.id}")
    head = [f" Calibrated by Kilter: version {version.version.id} of robot {version.version.robot}.", *written]
    root.append(Comment("\n  ".join(head).replace("--", "-") + "\n"))
    SubElement(root, "compiler", COMPILER)
    SubElement(root, "option", OPTION | {"gravity": numbers(exported.robot.gravity)})
    SubElement(root, "size", nuserdata=str(2 * calibration.robot.n_joints + 1))
    bodies(SubElement(root, "worldbody"), calibration, exported, driven, twisting(exported.form))
    actuators = SubElement(root, "actuator")
    for joint, drive in zip(calibration.robot.joints, driven, strict=True):
        own = {"name": joint.name, "joint": joint.name, "kp": repr(drive.gain), "dampratio": "1"}
        if abs(joint.lower) != float("inf") and abs(joint.upper) != float("inf"):
            own["ctrlrange"] = f"{joint.lower!r} {joint.upper!r}"
        SubElement(actuators, "position", own)
    custom = SubElement(root, "custom")
    SubElement(custom, "numeric", name=NOMINAL, data=nominal_frames(calibration))
    rest = table(exported.form)
    if rest is not None:
        SubElement(custom, "text", name=TABLE, data=rest)
    indent(root)
    return Written('<?xml version="1.0"?>\n' + tostring(root, encoding="unicode") + "\n", written)
