"""A version as URDF: the robot's own with corrected joint origins, or one made from its chain.

A URDF made from a robot that did not come from one: a frame on every axis, masses where the robot has them.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import numpy as np

from kilter_core.errors import RobotError
from kilter_core.transforms import inverse, rotation_exp
from kilter_core.types import Floats
from kilter_service.ground.core import core_arm, core_model
from kilter_service.robots.exporters.exportable import Exportable, Written, numbers, omissions, set_origin
from kilter_service.robots.importers.urdf import chain_document
from kilter_service.robots.importers.urdf_tree import UrdfJoint, parse, read_xml

if TYPE_CHECKING:
    from kilter_core.arm import Joint, JointFrames, Link, Robot, Screws
    from kilter_core.model import Calibration, FlangeFrames


SAME = 1e-12


def urdf_file(version: Exportable) -> Written:
    """Write the URDF; a comment at its head has what geometry cannot say."""
    notes = omissions(version.calibration)
    if version.robot["convention"] == "urdf":
        root = _correct_original_urdf(
            version.robot, core_model.flange_frames(version.calibration), version.calibration.robot.chain.driven
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
    T[:3, :3] = rotation_exp(joint.axis * joint.mimic.offset)
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


# URDF insists on these two limits; Kilter does not know them.
EFFORT, VELOCITY = "0", "0"
INERTIA = (("ixx", 0, 0), ("iyy", 1, 1), ("izz", 2, 2), ("ixy", 0, 1), ("ixz", 0, 2), ("iyz", 1, 2))


def new_urdf(name: str, calibration: Calibration) -> Element:
    """Build the tree base_link - joints - flange - tool.

    Raises:
        RobotError: no axis of a joint has ratio 1 or -1.

    """
    robot, screws = calibration.robot, core_model.flange_screws(calibration)
    leader = _leaders(robot, screws)
    turned = _normalise_leading_axes(screws, leader)
    frames = core_arm.joint_frames(turned)
    root = Element("robot", name=name)
    SubElement(root, "link", name="base_link")
    parent = "base_link"
    for k, origin in enumerate(frames.origin):
        joint = robot.joints[screws.joint[k]]
        own = leader[int(screws.joint[k])] == k
        if own:
            parent = _axis(root, parent, joint, joint.name, origin)
            continue
        ratio = float(turned.ratio[k])
        follower = _follower(joint, k, bool(screws.prismatic[k]), ratio)
        parent = _axis(root, parent, follower, follower.name, origin)
        SubElement(root[-1], "mimic", joint=joint.name, multiplier=repr(ratio), offset="0")
    if robot.has_masses:
        _add_masses(root, robot, calibration, frames, leader)
    _add_fixed_joint(root, parent, "flange", frames.end)
    _add_fixed_joint(root, "flange", "tool", core_model.wanted_tool(calibration))
    return root


def _leaders(robot: Robot, screws: Screws) -> dict[int, int]:
    """The axis of each joint that carries its name."""
    leaders = {}
    for j, joint in enumerate(robot.joints):
        own = [k for k in range(len(screws)) if screws.joint[k] == j and abs(screws.ratio[k]) == 1.0]
        if not own:
            raise RobotError(
                f"Joint {joint.name!r} moves its axes by ratios only; URDF needs one axis that moves with it one to one."
            )
        leaders[j] = own[0]
    return leaders


def _normalise_leading_axes(screws: Screws, leader: dict[int, int]) -> Screws:
    """Axes reversed where needed, so that the leading axis of each joint has ratio 1."""
    direction, ratio = screws.direction.copy(), screws.ratio.copy()
    for k in leader.values():
        direction[k] *= ratio[k]
        ratio[k] = 1.0
    return core_arm.Screws(direction, screws.point, screws.prismatic, screws.joint, ratio, screws.home)


def _axis(root: Element, parent: str, joint: Joint, name: str, origin: Floats) -> str:
    """Add a moving joint and its link; returns the link's name."""
    bounded = math.isfinite(joint.lower) and math.isfinite(joint.upper)
    kind = joint.kind if bounded or joint.kind == "prismatic" else "continuous"
    child = f"{name}_link"
    SubElement(root, "link", name=child)
    element = SubElement(root, "joint", name=name, type=kind)
    SubElement(element, "parent", link=parent)
    SubElement(element, "child", link=child)
    set_origin(element, origin)
    SubElement(element, "axis", xyz="0 0 1")
    if bounded:
        limits = {"lower": repr(joint.lower), "upper": repr(joint.upper), "effort": EFFORT, "velocity": VELOCITY}
        SubElement(element, "limit", limits)
    return child


def _follower(leader: Joint, k: int, slides: bool, ratio: float) -> Joint:
    """The joint of an axis that follows: as far as the leader takes it. Readers refuse an endless follower of a bounded one."""
    lower, upper = sorted((ratio * leader.lower, ratio * leader.upper))
    kind = "prismatic" if slides else "revolute"
    return replace(leader, name=f"{leader.name}_follower_{k + 1}", kind=kind, lower=lower, upper=upper)


def _add_fixed_joint(root: Element, parent: str, child: str, T: Floats) -> None:
    SubElement(root, "link", name=child)
    element = SubElement(root, "joint", name=f"{child}_joint", type="fixed")
    SubElement(element, "parent", link=parent)
    SubElement(element, "child", link=child)
    set_origin(element, T)


def _add_masses(
    root: Element, robot: Robot, calibration: Calibration, frames: JointFrames, leader: dict[int, int]
) -> None:
    """Give the links of the axes their masses, rotated from the chain's frames into the links'."""
    elements = core_model.flange_frames(calibration).elements
    at, T = [], np.eye(4)
    for origin in frames.origin:
        T = T @ origin
        at.append(T)
    behind = [link for link in root.findall("link") if link.get("name") != "base_link"]  # one for each axis, in order
    for j, link in enumerate(robot.links):
        if link.mass > 0:
            k = leader[j] if j < robot.n_joints else robot.chain.driven.index(link.element)
            _inertial(behind[k], link, np.linalg.inv(at[k]) @ elements[link.element + 1])


def _inertial(element: Element, link: Link, T: Floats) -> None:
    inertial = SubElement(element, "inertial")
    R = T[:3, :3]
    SubElement(inertial, "origin", xyz=numbers(R @ link.com + T[:3, 3]), rpy="0 0 0")
    SubElement(inertial, "mass", value=repr(link.mass))
    tensor = R @ link.inertia @ R.T
    SubElement(inertial, "inertia", {name: repr(float(tensor[a, b])) for name, a, b in INERTIA})
