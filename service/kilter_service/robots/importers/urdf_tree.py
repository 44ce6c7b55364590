"""URDF text into a tree of links and joints, SI, of no more elements than a robot needs; which make the arm is not asked."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cached_property
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import TreeBuilder

import numpy as np
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import DefusedXMLParser, ParseError

from kilter_core.errors import RobotError
from kilter_core.types import Floats
from kilter_files.ground.later import transform
from kilter_service.ground.core import transforms
from kilter_service.ground.limits import (
    MAX_LINK_NAME,
    MAX_LINKS,
    MAX_NAME,
    MAX_XML_ATTRIBUTES,
    MAX_XML_DEPTH,
    MAX_XML_TAGS,
    MAX_XML_VALUE,
)
from kilter_service.ground.naming import LINE

if TYPE_CHECKING:
    from collections.abc import Iterator
    from xml.etree.ElementTree import Element


SOFT = ("soft_lower_limit", "soft_upper_limit")


def unused_values(element: Element, kind: str) -> tuple[str, ...]:
    """Return a sentence for each value of a moving joint that is not used though it changes what its numbers mean."""
    name = str(element.get("name"))
    return (*_calibration(name, kind, element), *_limits(name, kind, element), *_soft_limits(name, kind, element))


def _calibration(name: str, kind: str, element: Element) -> Iterator[str]:
    for tag in element.findall("calibration"):
        values = [(edge, _value(tag, edge)) for edge in ("rising", "falling", "reference_position")]
        said = ", ".join(f"{edge} {_length_or_angle(value, kind)}" for edge, value in values if value)
        if said:
            yield f"{name}: <calibration> ({said}) is not used. An identification finds zero offsets by itself"


def _limits(name: str, kind: str, element: Element) -> Iterator[str]:
    limit = element.find("limit")
    if limit is None or kind == "continuous":
        return
    lower, upper = _value(limit, "lower") or 0.0, _value(limit, "upper") or 0.0
    said = f"lower {_length_or_angle(lower, kind)}, upper {_length_or_angle(upper, kind)}"
    if lower > upper:
        yield f"{name}: its limits are swapped ({said}) and are not used. Exchange them in the file"
    elif lower == upper:
        yield f"{name}: its limits leave no range ({said}) and are not used"
    elif math.isfinite(lower) != math.isfinite(upper):
        yield f"{name}: a limit on one side only ({said}) is not used"


def _soft_limits(name: str, kind: str, element: Element) -> Iterator[str]:
    safety = element.find("safety_controller")
    ends = [] if safety is None else [(end.split("_")[1], _value(safety, end)) for end in SOFT]
    if any(value for _, value in ends):
        said = ", ".join(f"{end} {_length_or_angle(value, kind)}" for end, value in ends if value is not None)
        yield f"{name}: soft limits of its <safety_controller> ({said}) are not used, its <limit> is"


def _value(element: Element, attribute: str) -> float | None:
    """Return a number of the file; None where there is none."""
    try:
        return float(element.get(attribute, ""))
    except ValueError:
        return None


def _length_or_angle(value: float, kind: str) -> str:
    return f"{1e3 * value:.6g} mm" if kind == "prismatic" else f"{math.degrees(value):.6g} deg"


MOVING = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
ROUNDED = 1e-4  # of a quaternion's length, or rad: numbers of a file with four digits
FREE = ("floating", "planar")  # they hold nothing: what hangs on them is not of the arm


@dataclass(frozen=True)
class Mimic:
    """``q = multiplier * q[joint] + offset``."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class UrdfJoint:
    """A joint: ``xyz`` m and ``rpy`` rad of its origin in the parent link, its axis (3,) in its own frame."""

    name: str
    kind: str
    parent: str
    child: str
    xyz: Floats
    rpy: Floats
    axis: Floats
    lower: float
    upper: float
    mimic: Mimic | None
    unused: tuple[str, ...] = ()  # values of the file that are not used, in words

    @property
    def moves(self) -> bool:
        """Whether an arm's joint moves it: it is neither fixed nor free."""
        return self.kind in MOVING

    @property
    def origin(self) -> Floats:
        """Pose (4, 4) of the joint in its parent link."""
        return transforms.pose_from_xyz_rpy(self.xyz, self.rpy)


@dataclass(frozen=True)
class Body:
    """Mass kg, centre of mass (3,) m and inertia (3, 3) kg·m² about it, in one frame."""

    mass: float = 0.0
    com: Floats = field(default_factory=lambda: np.zeros(3))
    inertia: Floats = field(default_factory=lambda: np.zeros((3, 3)))


@dataclass(frozen=True)
class UrdfTree:
    """Bodies by link name; joints by name, in the order of the file. Every link hangs on one joint at most, without loops."""

    bodies: dict[str, Body]
    joints: dict[str, UrdfJoint]

    def children(self, link: str) -> list[UrdfJoint]:
        """Joints whose parent is ``link``."""
        return self._children.get(link, [])

    @cached_property
    def above(self) -> dict[str, UrdfJoint]:
        """The joint that each link but the root hangs on."""
        return {joint.child: joint for joint in self.joints.values()}

    @cached_property
    def _children(self) -> dict[str, list[UrdfJoint]]:
        found: dict[str, list[UrdfJoint]] = {}
        for joint in self.joints.values():
            found.setdefault(joint.parent, []).append(joint)
        return found

    def path(self, base: str, tip: str) -> list[UrdfJoint]:
        """Joints from ``base`` to ``tip``; those that mimic name the joint at the end of their row of mimics.

        Raises:
            RobotError: a link that does not exist, no way from one to the other, a joint in between that is floating or
                planar, or one that mimics none that moves.

        """
        for place, link in (("base_link", base), ("tip_link", tip)):
            if link not in self.bodies:
                near = get_close_matches(link[:MAX_NAME], self.bodies, n=3, cutoff=0.4) or list(self.bodies)[:5]
                raise RobotError(
                    f"{place} {link!r} is not in the URDF. Near it: {', '.join(near)}.", field=place, near=near
                )
        found: list[UrdfJoint] = []
        link = tip
        while link != base:
            if link not in self.above:
                raise RobotError(
                    f"tip_link {tip!r} does not hang on base_link {base!r}: name a base_link nearer to the root.",
                    field="tip_link",
                )
            found.append(self.above[link])
            link = self.above[link].parent
        for joint in found:
            if joint.kind in FREE:
                raise RobotError(
                    f"joint {joint.name} is {joint.kind!r} and lies between {base!r} and {tip!r}: name two links with none "
                    "such in between.",
                    field="urdf",
                    place=joint.name,
                )
        return [replace(joint, mimic=self._resolve_mimic(joint)) for joint in reversed(found)]

    def _resolve_mimic(self, joint: UrdfJoint) -> Mimic | None:
        """Return what a joint mimics in the end: ``q = multiplier * q[driver] + offset`` through all mimics between."""
        total, passed = joint.mimic if joint.moves else None, [joint.name]
        while total is not None:
            other = self.joints.get(total.joint)
            if other is None or not other.moves or other.name in passed:
                fault = _mimic_fault(other, passed)
                raise RobotError(
                    f"joint {joint.name} mimics {total.joint[:MAX_NAME]!r}, which {fault}: name a joint that moves, or leave "
                    "<mimic> out.",
                    field="urdf",
                    place=joint.name,
                )
            if other.mimic is None:
                break
            passed.append(other.name)
            total = Mimic(
                other.mimic.joint,
                total.multiplier * other.mimic.multiplier,
                total.multiplier * other.mimic.offset + total.offset,
            )
        return total


def _mimic_fault(other: UrdfJoint | None, passed: list[str]) -> str:
    """Say why a joint cannot be mimicked by the first of ``passed``."""
    if other is None:
        return "is not in the URDF"
    if not other.moves:
        return f"is {other.kind}"
    return "is itself" if other.name == passed[-1] else "follows it in turn"


def parse(text: str) -> UrdfTree:
    """Read URDF text.

    Raises:
        RobotError: not XML, not URDF, xacro, too large, or a link or joint that cannot be.

    """
    root = read_xml(text)
    if root.tag != "robot":
        raise RobotError(f"The root element is <{root.tag[:MAX_NAME]}>, a URDF has <robot>.", field="urdf")
    links, joints = root.findall("link"), root.findall("joint")
    for what, found in (("links", links), ("joints", joints)):
        if len(found) > MAX_LINKS:
            raise RobotError(
                f"The URDF has {len(found)} {what}, at most {MAX_LINKS} are allowed: leave out what is not part of the arm.",
                field="urdf",
            )
    return _tree(
        {_name(e, "link"): e for e in _without_duplicates(links, "link")}, _without_duplicates(joints, "joint")
    )


def _without_duplicates(elements: list[Element], what: str) -> list[Element]:
    names: set[str] = set()
    for element in elements:
        name = _name(element, what)
        if name in names:
            raise RobotError(
                f"The URDF has two {what}s {name!r}: give each a name of its own.", field="urdf", place=name
            )
        names.add(name)
    return elements


def _tree(links: dict[str, Element], joints: list[Element]) -> UrdfTree:
    tree = UrdfTree(
        {name: _body(link) for name, link in links.items()}, {joint.name: joint for joint in map(_joint, joints)}
    )
    for joint in tree.joints.values():
        for end in (joint.parent, joint.child):
            if end not in tree.bodies:
                raise RobotError(
                    f"joint {joint.name} names link {end[:MAX_NAME]!r}, which the URDF does not have: add it.",
                    field="urdf",
                    place=joint.name,
                )
        other = tree.above[joint.child]
        if other is not joint:
            raise RobotError(
                f"Link {joint.child!r} is below joints {joint.name!r} and {other.name!r}: a URDF is a tree, leave one out.",
                field="urdf",
                place=joint.child,
            )
    _check_no_loop(tree)
    return tree


def _check_no_loop(tree: UrdfTree) -> None:
    """Links that cannot be reached from a root form a loop."""
    waiting = [link for link in tree.bodies if link not in tree.above]
    rooted = set(waiting)
    while waiting:
        below = [joint.child for joint in tree.children(waiting.pop())]
        rooted.update(below)
        waiting += below
    for link in tree.bodies:
        if link not in rooted:
            raise RobotError(
                f"Link {link!r} is below itself in a loop of joints: a URDF is a tree, leave one joint out.",
                field="urdf",
                place=link,
            )


def _name(element: Element, what: str) -> str:
    name = element.get("name")
    if not name:
        raise RobotError(f"A <{what}> of the URDF has no name.", field="urdf")
    if found := LINE.search(name):
        raise RobotError(
            f"The name {name[:MAX_NAME]!r} of a <{what}> has the invisible character U+{ord(found[0]):04X}: leave it out.",
            field="urdf",
        )
    if len(name) > MAX_LINK_NAME:
        raise RobotError(
            f"A <{what}> has a name of {len(name)} characters, at most {MAX_LINK_NAME} are allowed: {name[:MAX_NAME]!r}...",
            field="urdf",
        )
    return name


def numbers(element: Element | None, attribute: str, default: tuple[float, ...], place: str) -> Floats:
    """Finite numbers of an attribute, ``default`` where it is not there.

    Raises:
        RobotError: they are not as many numbers as the default.

    """
    text = None if element is None else element.get(attribute)
    if text is None:
        return np.array(default)
    try:
        values = np.array([float(part) for part in text.split()])
    except ValueError:
        values = np.array([math.nan])
    if values.shape != (len(default),) or not np.all(np.isfinite(values)):
        raise RobotError(
            f"{place}: {attribute}={text[:MAX_NAME]!r} is not {len(default)} numbers.", field="urdf", place=place
        )
    return values


def parse_rpy(origin: Element | None, place: str) -> Floats:
    """Roll, pitch, yaw (3,) rad of an origin, which may have a unit quaternion ``quat_xyzw`` instead.

    Raises:
        RobotError: the quaternion is none, or another rotation is given beside it.

    """
    rpy = numbers(origin, "rpy", (0, 0, 0), place)
    if origin is None or origin.get("quat_xyzw") is None:
        return rpy
    quaternion = numbers(origin, "quat_xyzw", (0, 0, 0, 1), place)
    if abs(np.linalg.norm(quaternion) - 1.0) > ROUNDED:
        raise RobotError(
            f"{place}: quat_xyzw has a length other than 1: give a unit quaternion.", field="urdf", place=place
        )
    rotation = transform.Rotation.from_quat(quaternion)
    if (
        origin.get("rpy") is not None
        and (rotation.inv() * transform.Rotation.from_euler("xyz", rpy)).magnitude() > ROUNDED
    ):
        raise RobotError(f"{place}: rpy and quat_xyzw are two rotations: leave one out.", field="urdf", place=place)
    T = np.eye(4)
    T[:3, :3] = rotation.as_matrix()
    return transforms.xyz_rpy_from_pose(T)[1]


def _body(link: Element) -> Body:
    place = f"link {link.get('name')}"
    inertial = link.find("inertial")
    if inertial is None:
        return Body()
    origin, tensor = inertial.find("origin"), inertial.find("inertia")
    T = transforms.pose_from_xyz_rpy(numbers(origin, "xyz", (0, 0, 0), place), parse_rpy(origin, place))
    six = [float(numbers(tensor, f"i{pair}", (0,), place)[0]) for pair in ("xx", "yy", "zz", "xy", "xz", "yz")]
    mass = float(numbers(inertial.find("mass"), "value", (0,), place)[0])
    return Body(mass, T[:3, 3], T[:3, :3] @ symmetric(six) @ T[:3, :3].T)


def symmetric(six: list[float]) -> Floats:
    """Tensor (3, 3) of xx, yy, zz, xy, xz, yz."""
    xx, yy, zz, xy, xz, yz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _joint(element: Element) -> UrdfJoint:
    name = _name(element, "joint")
    place, kind = f"joint {name}", str(element.get("type"))
    if kind not in (*MOVING, *FREE, "fixed"):
        raise RobotError(
            f"{place} is {kind[:MAX_NAME]!r}: URDF has revolute, continuous, prismatic, fixed, floating and planar.",
            field="urdf",
            place=place,
        )
    parent, child = element.find("parent"), element.find("child")
    if parent is None or child is None:
        raise RobotError(f"{place} lacks its parent or its child link.", field="urdf", place=place)
    origin, limit = element.find("origin"), element.find("limit")
    bounded = limit is not None and kind != "continuous"
    return UrdfJoint(
        name=name,
        kind=kind,
        parent=str(parent.get("link")),
        child=str(child.get("link")),
        xyz=numbers(origin, "xyz", (0, 0, 0), place),
        rpy=parse_rpy(origin, place),
        axis=_axis(element, place) if kind in MOVING else np.array([1.0, 0.0, 0.0]),
        lower=_limit(limit, "lower", place) if bounded else -math.inf,
        upper=_limit(limit, "upper", place) if bounded else math.inf,
        mimic=_mimic(element, place),
        unused=unused_values(element, kind) if kind in MOVING else (),
    )


def _limit(limit: Element | None, end: str, place: str) -> float:
    """Return one end of a range; infinite where the file says so."""
    text = "" if limit is None else limit.get(end, "")
    with suppress(ValueError):
        if math.isinf(float(text)):
            return float(text)
    return float(numbers(limit, end, (0,), place)[0])


def _axis(element: Element, place: str) -> Floats:
    axis = numbers(element.find("axis"), "xyz", (1, 0, 0), place)
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise RobotError(f"{place} has an axis of length zero.", field="urdf", place=place)
    return axis / length


def _mimic(element: Element, place: str) -> Mimic | None:
    mimic = element.find("mimic")
    if mimic is None:
        return None
    multiplier = float(numbers(mimic, "multiplier", (1,), place)[0])
    return Mimic(str(mimic.get("joint")), multiplier, float(numbers(mimic, "offset", (0,), place)[0]))


def read_xml(text: str, *, comments: bool = False) -> Element:
    """Read the root element of a URDF, with its comments where they are asked for.

    Raises:
        RobotError: not XML, xacro, entities or a DTD, or too many, too deep or too long elements.

    """
    _refuse_xacro(text)
    parser = DefusedXMLParser(target=_Counted(insert_comments=comments))
    try:
        for start in range(0, len(text), 1 << 16):
            parser.feed(text[start : start + (1 << 16)])
        root: Element = parser.close()
    except ParseError as error:
        raise RobotError(f"The URDF is not XML: {error}.", field="urdf") from error
    except DefusedXmlException as error:
        raise RobotError("The URDF declares XML entities or a DTD: remove them.", field="urdf") from error
    return root


def _refuse_xacro(text: str) -> None:
    bare = _without_comments(text)
    if "<xacro:" in bare or "${" in bare:
        raise RobotError(
            "This is xacro, not URDF: run `xacro robot.urdf.xacro > robot.urdf` and give the result.", field="urdf"
        )


def _without_comments(text: str) -> str:
    """Real URDF files carry the macros they came from in comments (TALOS does). Each character is looked at once."""
    parts, at = [], 0
    while (start := text.find("<!--", at)) >= 0 and (end := text.find("-->", start + 4)) >= 0:
        parts.append(text[at:start])
        at = end + 3
    return "".join([*parts, text[at:]])


class _Counted(TreeBuilder):
    """Builds elements and refuses when there are too many."""

    def __init__(self, *, insert_comments: bool) -> None:
        super().__init__(insert_comments=insert_comments)
        self._tags = self._depth = 0

    def start(self, tag: str, attributes: Any, /) -> Any:
        self._tags, self._depth = self._tags + 1, self._depth + 1
        longest = max((len(value) for value in attributes.values()), default=0)
        for size, most, what in (
            (self._tags, MAX_XML_TAGS, "elements"),
            (self._depth, MAX_XML_DEPTH, "elements inside each other"),
            (len(attributes), MAX_XML_ATTRIBUTES, "attributes in one element"),
            (max(len(tag), longest), MAX_XML_VALUE, "characters in one name or value"),
        ):
            if size > most:
                raise RobotError(
                    f"The URDF has more than {most} {what}: leave out what is not part of the arm.", field="urdf"
                )
        return super().start(tag, attributes)

    def end(self, tag: str, /) -> Any:
        self._depth -= 1
        return super().end(tag)
