"""A URDF and the two ends of an arm into a robot document of convention ``chain``.

The shapes that a URDF gives the links of an arm, each in the frame in which Kilter states the link's mass.
"""

from __future__ import annotations

import math
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import RobotError
from kilter_core.types import Floats
from kilter_service.contract.units import MAX_ELEMENTS, MAX_JOINTS
from kilter_service.ground.core import transforms
from kilter_service.robots.importers.urdf_tree import (
    FREE,
    MOVING,
    Body,
    UrdfJoint,
    UrdfTree,
    numbers,
    parse,
    parse_rpy,
    read_xml,
)

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


# Which constants of a URDF say what others say too: rotations about a joint's axis, and shifts along it.
#
# A joint's origin has six numbers. Rotating about the axis of the joint, or about that of the joint before, is what
# their zero offsets do, and shifting along an axis is the same before the joint as behind it. Of each such set one
# is identified: four numbers of a revolute joint, two of a prismatic one (Mooring, Roth and Driels 1991).

SUFFIXES = ("x", "y", "z", "rz", "ry", "rx")
LENGTH_M = 0.3  # of an arm: over it a rotation is compared with a shift
ALIKE = 1e-6  # share within which two are alike, and the first is kept
NOTHING = 1e-6  # of a unit column: dependent on those kept


def spares(path: Sequence[UrdfJoint]) -> frozenset[str]:
    """Names of the constants that are not identified beside the others, of the moving joints of an arm in order."""
    # Joints whose zero offsets act at the next one alike wherever it stands, and the way (4, 4) there from each.
    before: list[tuple[UrdfJoint, Floats]] = []
    out: list[str] = []
    last = max(k for k, joint in enumerate(path) if joint.moves)
    for k, joint in enumerate(path):
        before = [(one, way @ joint.origin) for one, way in before]
        if joint.moves:
            said = [
                *_by_itself(joint, last=k == last),
                *(twist for one in before for twist in _twists_of_earlier_joint(*one)),
            ]
            kept = _independent(_constants(joint), np.array(said).reshape(-1, 6).T)
            out += [f"{joint.name}_{suffix}" for n, suffix in enumerate(SUFFIXES) if n not in kept]
            # Prismatic joints in a row only shift: each of their zero offsets is the same shift behind all of them.
            run = [b for b in before if _is_prismatic(b[0])] if _is_prismatic(joint) else []
            before = [*run, (joint, np.eye(4))]
    return frozenset(out)


def _is_prismatic(joint: UrdfJoint) -> bool:
    return MOVING[joint.kind] == "prismatic"


def _by_itself(joint: UrdfJoint, *, last: bool) -> Iterator[Floats]:
    """Twists (6,) behind the origin that the zero offset says, or the next origin: shifts (3,), then rotations (3,)."""
    prismatic, axis = _is_prismatic(joint), joint.axis
    follows = joint.mimic is not None  # its zero offset is not a parameter
    if prismatic and not last:
        yield from np.eye(6)[:3]
        yield np.r_[0.0, 0.0, 0.0, axis]
    elif prismatic and not follows:
        yield np.r_[axis, 0.0, 0.0, 0.0]
    elif not prismatic:
        if not (last and follows):
            yield np.r_[0.0, 0.0, 0.0, axis]
        if not last:
            yield np.r_[axis, 0.0, 0.0, 0.0]


def _twists_of_earlier_joint(before: UrdfJoint, T: Floats) -> Iterator[Floats]:
    """Twist (6,) in a frame at ``T`` (4, 4) behind a joint that this joint's zero offset says."""
    if before.mimic is not None:
        return
    R, p = T[:3, :3], T[:3, 3]
    if _is_prismatic(before):
        yield np.r_[R.T @ before.axis, 0.0, 0.0, 0.0]
    else:
        yield np.r_[R.T @ np.cross(before.axis, p), R.T @ before.axis]


def _constants(joint: UrdfJoint) -> Floats:
    """Twists (6, 6) in the frame behind the origin, a column for each of :data:`SUFFIXES`."""
    out = np.zeros((6, 6))
    out[:3, :3] = joint.origin[:3, :3].T
    out[3:, 3:] = np.eye(3)[::-1]
    return out


def _independent(constants: Floats, said: Floats) -> set[int]:
    """Places of the columns (6, 6) that say most beside what is ``said (6, K)`` already and each other."""
    scale = np.r_[np.full(3, 1.0 / LENGTH_M), np.ones(3)][:, None]
    left, known = constants * scale, said * scale
    left = left / np.linalg.norm(left, axis=0)
    basis, size, _ = np.linalg.svd(known, full_matrices=False)
    # Of axes in one line two zero offsets say the same, and of two prismatic joints both say shifts: what counts is what
    # is said, not how often.
    basis = basis[:, size > NOTHING]
    left = left - basis @ (basis.T @ left)
    kept: set[int] = set()
    for _ in range(6 - basis.shape[1]):
        length = np.linalg.norm(left, axis=0)
        if length.max() < NOTHING:
            break
        best = int(np.flatnonzero(length >= (1.0 - ALIKE) * length.max())[0])
        kept.add(best)
        along = left[:, best] / length[best]
        left = left - np.outer(along, along @ left)
    return kept


Item = dict[str, Any]

MM = 1e3
STRAIGHT = 1e-12  # an axis this close to x, y or z is one of them
SHIFTS = (("x", "Tx"), ("y", "Ty"), ("z", "Tz"))
ROTATIONS = (("rz", "Rz", 2), ("ry", "Ry", 1), ("rx", "Rx", 0))  # as URDF composes roll, pitch and yaw


@dataclass(frozen=True)
class UrdfImport:
    """The document, and what of the URDF it leaves out.

    ``held_joints`` move links outside the chain: they are held at zero, their links' masses are part of the arm.
    ``link_frames`` has, for every joint that moves, the arm's joint whose link it carries ("": it follows one, with a link
    of its own), the URDF's link, and its pose (4, 4) m in the frame in which Kilter states the link's mass. ``mimics`` has
    the mimic joints of the path, and the element that each became. ``unused`` has sentences on values of the joints, and
    on floating and planar joints, that the document leaves out.
    """

    document: Item
    held_joints: tuple[str, ...] = ()
    link_frames: tuple[tuple[str, str, Floats], ...] = ()
    mimics: tuple[tuple[str, int], ...] = ()
    unused: tuple[str, ...] = ()


@dataclass
class _Chain:
    """Elements so far; ``frames`` has, per joint element, its link and the link's pose (4, 4) after the element."""

    elements: list[Item] = field(default_factory=list)
    frames: list[tuple[int, Floats, str]] = field(default_factory=list)
    mimics: list[tuple[str, int]] = field(default_factory=list)

    def add(self, **element: Any) -> None:
        self.elements.append(element)


def chain_document(text: str, base_link: str, tip_link: str, name: str) -> UrdfImport:
    """Convert URDF text to a ``chain`` document (mm, degrees) of the arm from ``base_link`` to ``tip_link``.

    Each moving joint's origin has six named elements. ``<joint>_x, _y, _z`` are its place in the parent link, and
    ``<joint>_rz, _ry, _rx`` rotations in the joint's own frame, zero behind the fixed roll, pitch and yaw of the file. Those
    that say what others say too are dependent; fixed joints become fixed elements. Fixed rotations bring an axis not along
    x, y or z there, and back after the joint.

    Raises:
        RobotError: the text is not URDF, the links do not exist, or nothing moves between them.

    """
    tree = parse(text)
    path = tree.path(base_link, tip_link)
    drivers = list(dict.fromkeys(joint.mimic.joint if joint.mimic else joint.name for joint in path if joint.moves))
    _check_drivers(drivers, base_link, tip_link)
    chain = _Chain()
    for joint in path:
        _append(chain, joint)
    if len(chain.elements) > MAX_ELEMENTS:
        raise RobotError(
            f"The arm from {base_link!r} to {tip_link!r} has {len(chain.elements)} elements, at most "
            f"{MAX_ELEMENTS} are allowed: merge fixed joints in a row.",
            field="urdf",
        )
    dependent = spares(path)
    for element in chain.elements:
        if element.get("name") in dependent:
            element["spare"] = True
    outside = _outside(tree, path, base_link)
    bodies = _bodies(tree, path, chain)
    primary = _primary(chain, drivers)
    return UrdfImport(
        document={
            "name": name,
            "convention": "chain",
            "joints": [_joint(tree, driver) for driver in drivers],
            "elements": chain.elements,
            "links": [*(_link(bodies[place]) for place in primary), *_followers(bodies, primary)],
        },
        held_joints=tuple(sorted(joint.name for joint in outside if joint.moves)),
        unused=(
            *(said for joint in path for said in joint.unused),
            *(
                f"{joint.name} is {joint.kind}: what hangs on it is not part of the arm"
                for joint in outside
                if joint.kind in FREE
            ),
        ),
        mimics=tuple(chain.mimics),
        link_frames=tuple((chain.elements[k]["joint"] if k in primary else "", link, T) for k, T, link in chain.frames),
    )


def _check_drivers(drivers: list[str], base_link: str, tip_link: str) -> None:
    if not drivers:
        raise RobotError(f"No joint moves between {base_link!r} and {tip_link!r}.", field="tip_link")
    if len(drivers) > MAX_JOINTS:
        raise RobotError(
            f"{len(drivers)} joints move between {base_link!r} and {tip_link!r}, an arm has at most {MAX_JOINTS}: name the "
            "two ends of one arm.",
            field="tip_link",
        )


def _append(chain: _Chain, joint: UrdfJoint) -> None:
    for (suffix, axis), metres in zip(SHIFTS, joint.xyz, strict=True):
        if joint.moves:
            chain.add(name=f"{joint.name}_{suffix}", axis=axis, value=float(metres * MM))
        elif metres:
            chain.add(axis=axis, value=float(metres * MM), fixed=True)
    for _, axis, k in ROTATIONS:
        if joint.rpy[k]:
            chain.add(axis=axis, value=math.degrees(joint.rpy[k]), fixed=True)
    if joint.moves:
        # Errors of roll, pitch and yaw themselves would be two directions instead of three at a pitch of 90 degrees.
        for suffix, axis, _ in ROTATIONS:
            chain.add(name=f"{joint.name}_{suffix}", axis=axis, value=0.0)
        _append_motion(chain, joint)


def _append_motion(chain: _Chain, joint: UrdfJoint) -> None:
    letter, sign, turns = _along(joint.axis)
    for axis, degrees in turns:
        chain.add(axis=axis, value=degrees, fixed=True)
    prismatic = MOVING[joint.kind] == "prismatic"
    multiplier, offset = (joint.mimic.multiplier, joint.mimic.offset) if joint.mimic else (1.0, 0.0)
    element: Item = {
        "joint": joint.mimic.joint if joint.mimic else joint.name,
        "axis": f"{'T' if prismatic else 'R'}{letter}",
    }
    if sign * multiplier != 1.0:
        element["ratio"] = sign * multiplier
    if offset:
        element["value"] = float(sign * offset * MM if prismatic else math.degrees(sign * offset))
    # The zero offset is a parameter of its own, though the origin's constants span it: level 1 identifies offsets only.
    chain.add(**element)
    if joint.mimic:
        chain.mimics.append((joint.name, len(chain.elements) - 1))
    chain.frames.append((len(chain.elements) - 1, _back(turns), joint.child))
    for axis, degrees in reversed(turns):
        chain.add(axis=axis, value=-degrees, fixed=True)


def _along(axis: Floats) -> tuple[str, float, list[tuple[str, float]]]:
    """Letter and sign of the axis, and the fixed rotations that bring z there when it is none of x, y, z."""
    k = int(np.argmax(np.abs(axis)))
    if np.linalg.norm(np.delete(axis, k)) < STRAIGHT:
        return "xyz"[k], math.copysign(1.0, axis[k]), []
    azimuth = math.degrees(math.atan2(axis[1], axis[0]))
    tilt = math.degrees(math.atan2(math.hypot(axis[0], axis[1]), axis[2]))
    return "z", 1.0, [("Rz", azimuth), ("Ry", tilt)]


def _back(turns: list[tuple[str, float]]) -> Floats:
    """Pose (4, 4) of the link in the frame right after the joint's element: the rotations undone."""
    T = np.eye(4)
    for axis, degrees in reversed(turns):
        k = "xyz".index(axis[1])
        a, b = (k + 1) % 3, (k + 2) % 3
        c, s = math.cos(math.radians(-degrees)), math.sin(math.radians(-degrees))
        step = np.eye(4)
        step[a, a], step[a, b], step[b, a], step[b, b] = c, -s, s, c
        T = T @ step
    return T


def _primary(chain: _Chain, drivers: list[str]) -> list[int]:
    """Element of each joint by the rule of kilter_core.arm.chain: the one with ratio ±1 where there is one, else its first."""
    own: dict[str, list[int]] = {}
    for k, _, _ in chain.frames:
        own.setdefault(chain.elements[k]["joint"], []).append(k)
    return [
        next((k for k in own[driver] if abs(chain.elements[k].get("ratio", 1.0)) == 1.0), own[driver][0])
        for driver in drivers
    ]


def _bodies(tree: UrdfTree, path: list[UrdfJoint], chain: _Chain) -> dict[int, Body]:
    """Return what moves rigidly with each joint element, in the frame right after it."""
    on_path = {joint.name for joint in path if joint.moves}
    return {k: in_frame(T, merge_rigid_links(tree, link, on_path)) for k, T, link in chain.frames}


def _followers(bodies: dict[int, Body], primary: list[int]) -> list[Item]:
    """Bodies behind mimic joints: they move with an axis of their own, which follows another joint."""
    return [
        _link(body) | {"on_axis": axis}
        for axis, (place, body) in enumerate(bodies.items(), 1)
        if place not in primary and body.mass > 0
    ]


def _joint(tree: UrdfTree, name: str) -> Item:
    joint = tree.joints[name]
    item: Item = {"name": name}
    if math.isfinite(joint.lower) and joint.lower < joint.upper:
        unit, scale = ("mm", MM) if joint.kind == "prismatic" else ("deg", 180.0 / math.pi)
        item[f"limits_{unit}"] = [joint.lower * scale, joint.upper * scale]
    return item


def _link(body: Body) -> Item:
    inertia = body.inertia
    six = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    return {
        "mass_kg": body.mass,
        "com_mm": [float(value) * MM for value in body.com],
        "inertia_kg_m2": [float(value) for value in six],
    }


def _outside(tree: UrdfTree, path: list[UrdfJoint], base_link: str) -> list[UrdfJoint]:
    """Joints that hang on the arm without being of the chain, none beyond a floating or planar one."""
    on_path = {joint.name for joint in path}
    outside, queue = [], [*(joint.child for joint in path), base_link]
    while queue:
        for joint in tree.children(queue.pop()):
            if joint.name not in on_path:
                outside.append(joint)
                queue += [] if joint.kind in FREE else [joint.child]
    return outside


def merge_rigid_links(tree: UrdfTree, link: str, cut: Container[str]) -> Body:
    """Return the body of ``link`` and all that hangs on it without a joint of ``cut`` in between, joints at zero."""
    body = tree.bodies[link]
    for T, other in hanging(tree, link, cut):
        body = together(body, in_frame(T, tree.bodies[other]))
    return body


def hanging(tree: UrdfTree, link: str, cut: Container[str]) -> Iterator[tuple[Floats, str]]:
    """Links that hang on ``link`` without a joint of ``cut`` in between, with their poses (4, 4) in it, joints at zero."""
    waiting = [(np.eye(4), joint) for joint in tree.children(link)]
    while waiting:
        T, joint = waiting.pop()
        if joint.name not in cut and joint.kind not in FREE:
            here = T @ joint.origin
            yield here, joint.child
            waiting += [(here, below) for below in tree.children(joint.child)]


def in_frame(T: Floats, body: Body) -> Body:
    """Return the body in the frame in which its own frame has the pose T (4, 4)."""
    R = T[:3, :3]
    return Body(body.mass, R @ body.com + T[:3, 3], R @ body.inertia @ R.T)


def together(a: Body, b: Body) -> Body:
    """Return two bodies of one frame as one (parallel axes)."""
    mass = a.mass + b.mass
    if mass == 0.0:
        return Body(0.0, np.zeros(3), a.inertia + b.inertia)
    com = (a.mass * a.com + b.mass * b.com) / mass
    return Body(mass, com, sum((_about(com, body) for body in (a, b)), np.zeros((3, 3))))


def _about(point: Floats, body: Body) -> Floats:
    d = body.com - point
    return body.inertia + body.mass * (float(d @ d) * np.eye(3) - np.outer(d, d))


BASE = "base"
MOST = 1000
LONGEST = 1000  # name of a file
SIZES = {"box": ("size", 3), "cylinder": ("radius length", 1), "sphere": ("radius", 1)}


@dataclass(frozen=True)
class Shape:
    """A shape of a URDF's link: a ``file`` with its ``scale``, or the ``size`` of a body, m; its pose (4, 4) m in the link."""

    kind: str
    pose: Floats
    file: str = ""
    scale: tuple[float, ...] = (1.0, 1.0, 1.0)
    size: tuple[float, ...] = ()


@dataclass(frozen=True)
class LinkShapes:
    """Shapes by link of the arm: (link, the URDF's link, shape with its pose in the arm's link); and links left out."""

    shapes: list[tuple[str, str, Shape]] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)


def link_shapes(text: str, base_link: str, tip_link: str) -> LinkShapes:
    """Return what a URDF draws of the arm from ``base_link`` to ``tip_link``, joints outside the arm at zero.

    Raises:
        RobotError: the text is not URDF, or one of its shapes cannot be.

    """
    tree, found = parse(text), LinkShapes()
    shapes = _shapes(text)
    arm = chain_document(text, base_link, tip_link, "")
    moving = {joint.name for joint in tree.joints.values() if joint.moves}
    on_path = {joint.name for joint in tree.path(base_link, tip_link) if joint.moves}
    frames = ((BASE, base_link, np.eye(4), moving), *((*one, on_path) for one in arm.link_frames))
    for name, link, T, cut in frames:
        for below, other in ((T, link), *((T @ here, other) for here, other in hanging(tree, link, cut))):
            if not name and shapes[other]:
                found.left_out.append(other)
            elif name:
                found.shapes.extend((name, other, _transform_shape(below, shape)) for shape in shapes[other])
    return found


def _transform_shape(T: Floats, shape: Shape) -> Shape:
    return Shape(shape.kind, T @ shape.pose, shape.file, shape.scale, shape.size)


def _shapes(text: str) -> dict[str, list[Shape]]:
    links = read_xml(text).findall("link")
    found = {str(link.get("name")): [*_parse_link_shapes(link)] for link in links}
    if sum(map(len, found.values())) > MOST:
        raise RobotError(
            f"The URDF draws more than {MOST} shapes: leave out what is not part of the arm.", field="urdf"
        )
    return found


def _parse_link_shapes(link: Element) -> Iterator[Shape]:
    place = f"link {link.get('name')}"
    for visual in link.findall("visual"):
        origin, geometry = visual.find("origin"), visual.find("geometry")
        pose = transforms.pose_from_xyz_rpy(numbers(origin, "xyz", (0, 0, 0), place), parse_rpy(origin, place))
        for one in [] if geometry is None else geometry:
            if one.tag == "mesh":
                file = one.get("filename") or ""
                if not 0 < len(file) <= LONGEST:
                    raise RobotError(f"{place}: a mesh has no filename, or too long a one.", field="urdf", place=place)
                yield Shape("mesh", pose, file, tuple(map(float, numbers(one, "scale", (1, 1, 1), place))))
            elif one.tag in SIZES:
                names, count = SIZES[one.tag]
                size = [x for name in names.split() for x in map(float, numbers(one, name, (0,) * count, place))]
                if min(size) > 0.0:  # nothing is to be seen of another
                    yield Shape(one.tag, pose, size=tuple(size))
