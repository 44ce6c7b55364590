"""The shapes that a URDF gives the links of an arm, each in the frame in which Kilter states the link's mass."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from kilter_core.errors import RobotError
from kilter_core.types import Floats
from kilter_service.ground.core import transforms
from kilter_service.robots.importers.urdf import chain_document, hanging
from kilter_service.robots.importers.urdf_tree import numbers, parse, parse_rpy, read_xml

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


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
