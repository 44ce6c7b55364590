"""A joint of a URDF that its controller reads against the horizontal: an axis that mimics the joint before rotates it back."""

from __future__ import annotations

import math
from collections.abc import Iterator
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import UsageError
from kilter_files.ground.later import np
from kilter_files.ground.names import did_you_mean

ROTATING = ("revolute", "continuous")
PARALLEL = math.cos(math.radians(1.0))


def uncoupled_urdf(text: str, follower: str, leader: str) -> str:
    """Return a URDF in which ``follower`` keeps its reading in space while ``leader`` moves.

    A massless link between them rotates about the follower's axis and mimics the leader backwards.

    Raises:
        UsageError: a joint that is not there, or that does not rotate about an axis parallel to the leader's after it.

    """
    root = ElementTree.fromstring(text)  # noqa: S314 - the reader refused document types, without which there are no entities
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    for name in (leader, follower):
        if name not in joints:
            raise UsageError(
                f"There is no joint {name!r}{did_you_mean(name, list(joints))}. There are: {', '.join(joints)}."
            )
    first, second = joints[leader], joints[follower]
    between = _path_between_joints(root, first, second)
    if between is None or any(joint.get("type") not in ROTATING for joint in (first, second)):
        raise UsageError(_misplaced_axis_message(follower, leader))
    rotation = np.eye(3)
    for joint in between:
        rotation = rotation @ _origin(joint)
    along = float(_axis(first) @ rotation @ _axis(second))
    if abs(along) < PARALLEL:
        raise UsageError(_misplaced_axis_message(follower, leader))
    _insert(root, second, leader, -math.copysign(1.0, along))
    return ElementTree.tostring(root, encoding="unicode")


def _misplaced_axis_message(follower: str, leader: str) -> str:
    return f"--follows {follower}={leader}: the axis of {follower} must come after and be parallel to {leader}'s."


def _path_between_joints(root: Element, first: Element, second: Element) -> list[Element] | None:
    """The joints after the first one up to the second, in order; None where the second hangs on another branch."""
    above = {_link(joint, "child"): joint for joint in root.findall("joint")}
    found = list(_up(above, second, first))
    return found[::-1] if found and _link(found[-1], "parent") == _link(first, "child") else None


def _up(above: dict[str, Element], joint: Element | None, last: Element) -> Iterator[Element]:
    """The joints from one to the base, up to one that is not given any more."""
    passed: set[str] = set()
    while joint is not None and joint is not last and _link(joint, "child") not in passed:
        passed.add(_link(joint, "child"))
        yield joint
        joint = above.get(_link(joint, "parent"))


def _link(joint: Element, end: str) -> str:
    found = joint.find(end)
    return "" if found is None else found.get("link", "")


def _numbers(joint: Element, tag: str, name: str, usual: str) -> Floats:
    found = joint.find(tag)
    return np.array([float(cell) for cell in (usual if found is None else found.get(name, usual)).split()])


def _axis(joint: Element) -> Floats:
    axis = _numbers(joint, "axis", "xyz", "1 0 0")
    return np.asarray(axis / np.linalg.norm(axis))


def _origin(joint: Element) -> Floats:
    """Rotation (3, 3) of a joint's frame in its parent link."""
    roll, pitch, yaw = _numbers(joint, "origin", "rpy", "0 0 0")
    (a, b, c), (d, e, f) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, a, -d], [0.0, d, a]])
    about_y = np.array([[b, 0.0, e], [0.0, 1.0, 0.0], [-e, 0.0, b]])
    about_z = np.array([[c, -f, 0.0], [f, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_z @ about_y @ about_x)


def _insert(root: Element, follower: Element, leader: str, multiplier: float) -> None:
    """Put a link before the follower that mimics the leader about the follower's axis."""
    stem = f"{follower.get('name')}_against_{leader}"
    parent, axis, origin = (follower.find(tag) for tag in ("parent", "axis", "origin"))
    assert parent is not None
    joint = ElementTree.SubElement(root, "joint", name=stem, type="continuous")
    ElementTree.SubElement(root, "link", name=f"{stem}_link")
    ElementTree.SubElement(joint, "parent", link=parent.get("link", ""))
    ElementTree.SubElement(joint, "child", link=f"{stem}_link")
    if origin is not None:
        joint.append(origin)
        follower.remove(origin)
    if axis is not None:
        ElementTree.SubElement(joint, "axis", dict(axis.attrib))
    ElementTree.SubElement(joint, "mimic", joint=leader, multiplier=f"{multiplier:g}")
    parent.set("link", f"{stem}_link")
