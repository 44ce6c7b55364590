"""Shapes, coupled joints and poses from URDF and USD.

UsdPhysics keeps the local poses of a joint in single precision, which is 0.03 um at 0.5 m. Of the two poses of each body,
where its own joint and where the next one is, only the difference counts: one takes what rounding leaves of the other.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import FileError, UsageError, did_you_mean, fault
from kilter_files.ground.later import need, np, transform

if TYPE_CHECKING:
    from kilter_files.ground.arrays import Floats


MOST_TRIANGLES = 100_000  # of a link, as the server takes them
M_TO_MM = 1e3
TOGETHER = "trimesh fast-simplification pycollada lxml"
_PLACE = re.compile(r"^(?:package|model)://(?P<package>[^/]+)/(?P<path>.+)$")


@dataclass(frozen=True)
class LinkMesh:
    """The shape of a link: a binary STL in mm, how many triangles it has, and had before it was simplified."""

    link: str
    content: bytes
    triangles: int
    before: int


def link_meshes(
    shapes: Iterable[Mapping[str, Any]], urdf: Path, packages: Mapping[str, Path] | None = None
) -> list[LinkMesh]:
    """Read what a server says that the robot's URDF draws (``GET /v1/robots/{robot}/urdf-shapes``).

    Files are looked for beside the URDF, those of packages in the folders named or above the URDF. A link of too many
    triangles is simplified.

    Args:
        shapes: the server's rows.
        urdf: the URDF's file; only its folder counts.
        packages: folders of ROS packages by name.

    Raises:
        FileError: a file is not there, or cannot be read as a mesh.
        MissingPackageError: trimesh is not installed.

    """
    # trimesh makes meshes coarser with the other
    trimesh = need("Shapes that a URDF names need", "trimesh", "fast_simplification", "trimesh", install=TOGETHER)
    by_link: dict[str, list[Any]] = {}
    for shape in shapes:
        mesh = _load_shape(trimesh, shape, urdf, packages or {})
        mesh.apply_transform(shape["transform"])
        by_link.setdefault(shape["link"], []).append(mesh)
    return [_merge_meshes(trimesh, link, parts) for link, parts in by_link.items()]


def _load_shape(trimesh: Any, shape: Mapping[str, Any], urdf: Path, packages: Mapping[str, Path]) -> Any:
    if shape.get("box_mm"):
        return trimesh.creation.box(extents=shape["box_mm"])
    if shape.get("cylinder_mm"):
        radius, height = shape["cylinder_mm"]
        return trimesh.creation.cylinder(radius=radius, height=height)
    if shape.get("sphere_mm"):
        return trimesh.creation.icosphere(subdivisions=3, radius=shape["sphere_mm"])
    path = find_mesh_file(shape["file"], urdf, packages)
    try:
        mesh = trimesh.load_mesh(path, process=False)
    except Exception as error:  # each format raises what its reader does
        raise fault(path, f"cannot be read as a mesh ({error})", "Write it again as STL, OBJ or DAE.") from error
    if not len(getattr(mesh, "faces", ())):
        raise fault(path, "has no triangle", "Write it again as STL, OBJ or DAE.")
    mesh.apply_scale([M_TO_MM * factor for factor in shape["scale"]])
    return mesh


def find_mesh_file(name: str, urdf: Path, packages: Mapping[str, Path]) -> Path:
    """Return the file that a URDF names: beside it, at its whole path, or in a package.

    Raises:
        FileError: it is nowhere.

    """
    named = _PLACE.match(name)
    if named is None:
        places = [urdf.parent / name.removeprefix("file://")]
    elif named["package"] in packages:
        places = [packages[named["package"]] / named["path"]]
    else:
        above = urdf.resolve().parents
        places = [folder / named["package"] / named["path"] for folder in above]
        places += [folder / named["path"] for folder in above if folder.name == named["package"]]
    for place in places:
        if place.is_file():
            return place
    remedy = "say where it is with --package NAME=FOLDER" if named else "put it where the URDF says"
    raise FileError(f"{urdf}: names {name!r}, which is not at {places[0]}: {remedy}.", file=str(urdf))


def _merge_meshes(trimesh: Any, link: str, parts: list[Any]) -> LinkMesh:
    mesh = trimesh.util.concatenate(parts)
    before = len(mesh.faces)
    if before > MOST_TRIANGLES:
        mesh = mesh.simplify_quadric_decimation(face_count=MOST_TRIANGLES)
    return LinkMesh(link, mesh.export(file_type="stl"), len(mesh.faces), before)


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


NOMINAL, TOOL = "kilter:nominalFrames", "kilter_tool"
STEP_TABLE = "kilter:stepTable"
_PARTS = tuple(f"pxr.{part}" for part in ("Gf", "Sdf", "Tf", "Usd", "UsdGeom", "UsdPhysics"))


def usd_package() -> Any:
    """Return ``pxr``.

    Raises:
        MissingPackageError: it is not installed.

    """
    usd = need("USD needs", "usd-core", *_PARTS, "pxr")
    need("USD needs", "scipy", "scipy.spatial.transform")
    return usd


def pose_matrix(place: Any, turn: Any) -> Floats:
    """Pose (4, 4) by a USD vector and a USD quaternion, which is normalised in double precision."""
    T = np.eye(4)
    T[:3, :3] = transform.Rotation.from_quat(
        [*(float(v) for v in turn.GetImaginary()), float(turn.GetReal())]
    ).as_matrix()
    T[:3, 3] = [float(v) for v in place]
    return T


def single(T: Floats) -> Floats:
    """A pose (4, 4) as it is read again from single precision."""
    Gf = usd_package().Gf
    place, turn = local_pose(T)
    return pose_matrix(Gf.Vec3f(*place), Gf.Quatf(turn[0], *turn[1:]))


def local_pose(T: Floats) -> tuple[list[float], list[float]]:
    """Position and quaternion (w, x, y, z) of a pose (4, 4)."""
    x, y, z, w = (float(v) for v in transform.Rotation.from_matrix(T[:3, :3]).as_quat())
    return [float(v) for v in T[:3, 3]], [w, x, y, z]


def split(before: Floats, behind: Floats) -> tuple[Floats, Floats]:
    """Move a body's frame so that rounding moves none of its joints.

    Args:
        before: pose (4, 4) of the joint that carries the body, in the body.
        behind: pose (4, 4) of the next joint in the body.

    Returns:
        Both poses as they are to be written.

    """
    rounded, link = single(behind), np.linalg.inv(before) @ behind
    # The first is not what the file will hold, but what is lost there is the rounding of a small number.
    wanted = rounded @ np.linalg.inv(link)
    return wanted, rounded
