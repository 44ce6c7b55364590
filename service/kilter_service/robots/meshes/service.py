"""What can be done with meshes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from kilter_service.contract.robots import Mesh, MeshList, MeshUnit, UrdfShape, UrdfShapes
from kilter_service.ground.db import Database
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.limits import MAX_TRIANGLES
from kilter_service.ground.naming import copy_fields
from kilter_service.ground.wire import to_mm
from kilter_service.robots import store as robots
from kilter_service.robots.importers.urdf import link_shapes
from kilter_service.robots.meshes import store
from kilter_service.robots.meshes.store import MeshRecord

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from kilter_service.robots.importers.urdf import Shape

    Triangles = NDArray[np.float64]

BASE = "base"
MEDIA: dict[str, Literal["stl", "obj"]] = {"model/stl": "stl", "model/obj": "obj"}

HEADER, RECORD = 84, 50  # bytes of a binary STL: its head with the count, and each triangle
MAX_COORDINATE = 1e6
MAX_CORNERS = 64  # of a face


def format_from_content_type(header: str) -> Literal["stl", "obj"]:
    """Return the format that a content-type header names.

    Raises:
        ServiceError: none that is read.

    """
    plain = header.partition(";")[0].strip().lower()
    if plain not in MEDIA:
        raise ServiceError(
            f"Content-Type {plain[:40] or '(none)'} is not read: send {' or '.join(MEDIA)}.",
            code="media_type_unsupported",
        )
    return MEDIA[plain]


def form_of_name(name: str) -> Literal["stl", "obj"]:
    """Return the format that the name of a file ends in.

    Raises:
        ServiceError: none that is read.

    """
    ending = name.rpartition(".")[2].lower()
    if ending not in MEDIA.values():
        raise ServiceError(
            f"{name[:80] or 'A file without a name'} is not read: choose a file that ends in .stl or .obj.",
            code="media_type_unsupported",
        )
    return "stl" if ending == "stl" else "obj"


def check_link(database: Database, robot: str, link: str) -> None:
    """Refuse a link that the robot does not have, before its mesh is read.

    Raises:
        ServiceError: there is no such robot or link, or the robot is retired.

    """
    with database.reading() as session:
        links = [BASE, *(joint.name for joint in robots.usable(session, robot).robot().joints)]
    if link not in links:
        raise ServiceError(
            f"Robot {robot!r} has no link {link[:64]!r}: name `base` or the joint that moves it. There are {', '.join(links)}.",
            code="option_invalid",
            link=link,
        )


def put(
    database: Database, robot: str, link: str, path: Path, form: Literal["stl", "obj"], unit: MeshUnit, sha256: str
) -> Mesh:
    """Check a file and store it as the shape of a link, in place of the one it has.

    Raises:
        ServiceError: it is not a mesh.

    """
    content = path.read_bytes()
    record = MeshRecord(link, form, unit, len(triangles(content, form)), sha256, utc_now())
    with database.transaction() as session:
        robot_id = robots.usable(session, robot).id
        store.put(session, robot_id, record, content)
        return _mesh_from_record(robot, store.get(session, robot_id, link)[0])


def file(database: Database, robot: str, link: str) -> tuple[bytes, str]:
    """Return the file of a link as it was sent, and its media type."""
    with database.reading() as session:
        record, content = store.get(session, robots.get(session, robot).id, link)
    return content, f"model/{record.format}"


def corners(database: Database, robot: str, link: str) -> NDArray[np.float64]:
    """Return the triangles (T, 3, 3) of a link, mm."""
    with database.reading() as session:
        record, content = store.get(session, robots.get(session, robot).id, link)
    found = triangles(content, record.format)
    return to_mm(found) if record.unit == "m" else found


def list_meshes(database: Database, robot: str) -> MeshList:
    """List the meshes of a robot, from base to tool."""
    with database.reading() as session:
        stored = robots.get(session, robot)
        found = {one.link: one for one in store.meshes_of_robot(session, stored.id)}
        order = [BASE, *(joint.name for joint in stored.robot().joints)] if found else []
    return MeshList(meshes=[_mesh_from_record(robot, found[link]) for link in order if link in found])


def of_urdf(database: Database, robot: str) -> UrdfShapes:
    """Return what the URDF of a robot draws of its arm.

    Raises:
        ServiceError: the robot was not described by a URDF.

    """
    with database.reading() as session:
        document = robots.get(session, robot).document
    if document["convention"] != "urdf":
        raise ServiceError(
            f"Robot {robot!r} was not described by a URDF, which would name shapes: give each link its file "
            "(`kilter robot mesh set`).",
            code="option_invalid",
        )
    found = link_shapes(document["urdf"], document["base_link"], document["tip_link"])
    return UrdfShapes(shapes=[_to_urdf_shape(*one) for one in found.shapes], left_out=found.left_out)


def _to_urdf_shape(link: str, urdf_link: str, shape: Shape) -> UrdfShape:
    transform = shape.pose.copy()
    transform[:3, 3] = to_mm(transform[:3, 3])
    size: dict[str, object] = {"file": shape.file, "scale": shape.scale}
    if shape.kind != "mesh":
        mm = [float(to_mm(value)) for value in shape.size]
        size = {f"{shape.kind}_mm": mm[0] if shape.kind == "sphere" else mm}
    return UrdfShape.model_validate({"link": link, "urdf_link": urdf_link, "transform": transform.tolist(), **size})


def remove(database: Database, robot: str, link: str) -> None:
    """Delete the mesh of a link: it is drawn as a cylinder again."""
    with database.transaction() as session:
        store.remove(session, robots.get(session, robot).id, link)


def _mesh_from_record(robot: str, record: MeshRecord) -> Mesh:
    return copy_fields(Mesh, record, robot=robot)


def triangles(content: bytes, form: str) -> Triangles:
    """Return the corners (T, 3, 3) of the triangles of a file, in its own unit.

    Raises:
        ServiceError: it is not such a file, or it has no triangle, too many, or a number that cannot be.

    """
    found = np.array(list(_obj(_text(content))) if form == "obj" else _stl(content), dtype=np.float64).reshape(-1, 3, 3)
    if not len(found):
        raise invalid_mesh_error("it has no triangle")
    if not np.isfinite(found).all() or np.abs(found).max() > MAX_COORDINATE:
        raise invalid_mesh_error(f"a coordinate is not a number, or beyond {MAX_COORDINATE:g}")
    if not np.ptp(found.reshape(-1, 3), axis=0).max() > 0.0:
        raise invalid_mesh_error("all its corners are the same point")
    return found


def invalid_mesh_error(why: str) -> ServiceError:
    """Return the refusal of a file."""
    return ServiceError(
        f"This cannot be a mesh: {why}. Write it again as STL or OBJ with triangles.", code="mesh_invalid"
    )


def _stl(content: bytes) -> Sequence[float] | Triangles:
    """A binary file says how long it is; one that is as long as it says is binary, also when it begins with `solid`."""
    count = int.from_bytes(content[80:HEADER], "little") if len(content) >= HEADER else -1
    if count >= 0 and len(content) == HEADER + RECORD * count:
        _check_count(count)
        record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
        return np.asarray(np.frombuffer(content, record, count, HEADER)["corners"], dtype=np.float64)
    if content.lstrip()[:5].lower() == b"solid":
        return list(_text_stl(_text(content)))
    raise invalid_mesh_error(
        f"it says {max(count, 0)} triangles, which are {HEADER + RECORD * max(count, 0)} bytes, and has {len(content)}"
    )


def _text(content: bytes) -> Iterator[tuple[int, list[str]]]:
    try:
        lines = content.decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise invalid_mesh_error("it is neither a binary STL nor text") from error
    for number, line in enumerate(lines, 1):
        if words := line.split("#", 1)[0].split():
            yield number, words


def _text_stl(lines: Iterator[tuple[int, list[str]]]) -> Iterator[float]:
    corners = 0
    for number, words in lines:
        first = words[0].lower()
        if first == "vertex":
            corners += 1
            _check_count(corners // 3)
            yield from _point(number, words[1:])
        elif first == "endloop" and corners % 3:
            raise invalid_mesh_error(f"the face that ends in line {number} has other than three corners")
    if corners % 3:
        raise invalid_mesh_error("its last face has other than three corners")


def _obj(lines: Iterator[tuple[int, list[str]]]) -> Iterator[float]:
    points: list[list[float]] = []
    count = 0
    for number, words in lines:
        if words[0] == "v":
            points.append(_point(number, words[1:4]))
        elif words[0] == "f":
            corners = [_corner(number, word, points) for word in words[1 : MAX_CORNERS + 2]]
            if not 3 <= len(corners) <= MAX_CORNERS:
                raise invalid_mesh_error(
                    f"the face in line {number} has fewer than 3 corners or more than {MAX_CORNERS}"
                )
            count += len(corners) - 2
            _check_count(count)
            for second, third in pairwise(corners[1:]):
                for corner in (corners[0], second, third):
                    yield from corner


def _corner(number: int, word: str, points: list[list[float]]) -> list[float]:
    """The point that a corner names: counted from 1, or from the last one back."""
    text = word.partition("/")[0]
    try:
        place = int(text)
        return points[place - 1 if place > 0 else place] if place else points[len(points)]
    except (ValueError, IndexError):
        raise invalid_mesh_error(f"line {number} names point {text[:20]!r}, and {len(points)} came before") from None


def _point(number: int, words: Sequence[str]) -> list[float]:
    try:
        found = [float(word) for word in words]
    except ValueError:
        found = []
    if len(found) != 3 or not all(math.isfinite(value) for value in found):
        raise invalid_mesh_error(f"line {number} has no three numbers")
    return found


def _check_count(count: int) -> None:
    if count > MAX_TRIANGLES:
        raise invalid_mesh_error(f"it has more than {MAX_TRIANGLES} triangles: simplify it")
