"""What can be done with meshes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from kilter_service.contract.meshes import Mesh, MeshList, MeshUnit, UrdfShape, UrdfShapes
from kilter_service.ground.db import Database
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.wire import to_mm
from kilter_service.robots import store as robots
from kilter_service.robots.importers.urdf_shapes import link_shapes
from kilter_service.robots.meshes import store
from kilter_service.robots.meshes.reading import triangles
from kilter_service.robots.meshes.records import MeshRecord

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from kilter_service.robots.importers.urdf_shapes import Shape

BASE = "base"
MEDIA: dict[str, Literal["stl", "obj"]] = {"model/stl": "stl", "model/obj": "obj"}


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
    return Mesh(
        robot=robot,
        link=record.link,
        format=record.format,
        unit=record.unit,
        triangles=record.triangles,
        sha256=record.sha256,
        created_at=record.created_at,
    )
