"""A version as URDF: the robot's own with corrected joint origins, or one made from its chain."""

from __future__ import annotations

from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import numpy as np
from scipy.spatial.transform import Rotation

from kilter_core.model import FlangeFrames, flange_frames
from kilter_core.transforms import inverse
from kilter_core.types import Floats
from kilter_service.robots.exporters.exportable import Exportable, Written, omissions, set_origin
from kilter_service.robots.exporters.urdf_new import new_urdf
from kilter_service.robots.importers.urdf import chain_document
from kilter_service.robots.importers.urdf_tree import UrdfJoint, parse
from kilter_service.robots.importers.xml_text import read_xml

SAME = 1e-12


def urdf_file(version: Exportable) -> Written:
    """Write the URDF; a comment at its head has what geometry cannot say."""
    notes = omissions(version.calibration)
    if version.robot["convention"] == "urdf":
        root = _correct_original_urdf(
            version.robot, flange_frames(version.calibration), version.calibration.robot.chain.driven
        )
    else:
        root = new_urdf(version.version.robot, version.calibration)
    head = [f" Calibrated by Kilter: version {version.version.id} of robot {version.version.robot}.", *notes]
    root.insert(0, Comment("\n  ".join(head).replace("--", "-") + "\n"))
    indent(root)
    return Written('<?xml version="1.0"?>\n' + tostring(root, encoding="unicode") + "\n", notes)


def _correct_original_urdf(robot: dict[str, str], found: FlangeFrames, driven: tuple[int, ...]) -> Element:
    """The original file, comments and all, with the origins of the chain's joints replaced."""
    root = read_xml(robot["urdf"], comments=True)
    path = parse(robot["urdf"]).path(robot["base_link"], robot["tip_link"])
    children = iter(_children(robot, found, driven))
    elements = {joint.get("name"): joint for joint in root.findall("joint")}
    before = np.eye(4)
    for joint in path:
        child = next(children) if joint.moves else before @ joint.origin
        last = joint is path[-1] and not joint.moves
        child = child @ found.end if last else child
        origin = inverse(before) @ child @ inverse(_at_zero(joint))
        if np.abs(origin - joint.origin).max() > SAME:
            set_origin(elements[joint.name], origin)
        before = child
    if path[-1].moves and np.abs(found.end - np.eye(4)).max() > SAME:
        _add_tip(root, elements[path[-1].name], robot["tip_link"], found.end)
    return root


def _children(robot: dict[str, str], found: FlangeFrames, driven: tuple[int, ...]) -> list[Floats]:
    """Poses (4, 4) of the links behind the moving joints, of elements of today or of an earlier release."""
    arm = chain_document(robot["urdf"], robot["base_link"], robot["tip_link"], "")
    return [found.elements[k + 1] @ T for k, (_, _, T) in zip(driven, arm.link_frames, strict=True)]


def _at_zero(joint: UrdfJoint) -> Floats:
    """What the joint adds at zero: nothing but the offset of a mimic joint."""
    T = np.eye(4)
    if joint.mimic is None or joint.mimic.offset == 0.0:
        return T
    if joint.kind == "prismatic":
        T[:3, 3] = joint.axis * joint.mimic.offset
        return T
    T[:3, :3] = Rotation.from_rotvec(joint.axis * joint.mimic.offset).as_matrix()
    return T


def _add_tip(root: Element, joint: Element, tip: str, end: Floats) -> None:
    """Let a fixed joint lead from the last moving joint to the tip: a moving joint's origin cannot hold a shifted tip."""
    between, child = f"{tip}_before_calibration", joint.find("child")
    assert child is not None  # parsed before
    child.set("link", between)
    SubElement(root, "link", name=between)
    fixed = SubElement(root, "joint", name=f"{tip}_calibration", type="fixed")
    SubElement(fixed, "parent", link=between)
    SubElement(fixed, "child", link=tip)
    set_origin(fixed, end)
