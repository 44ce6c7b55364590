"""Verbs about the shapes of a robot's links."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import Literal

from kilter_client import typed
from kilter_client.errors import UsageError
from kilter_client.files import files_robots
from kilter_client.requests.calls import robots
from kilter_client.requests.steps import Steps
from kilter_client.results.record import Records
from kilter_client.verbs.references import ResourceReference, reference

FORMS: Mapping[str, robots.Form] = {".stl": "stl", ".obj": "obj"}


def meshes(robot: ResourceReference) -> Steps[Records[typed.robots.Mesh]]:
    """Return the shapes of a robot's links, from base to tool.

    Raises:
        NotFoundError: there is no such robot.

    """
    found = yield from robots.list_meshes(reference("robot", robot))
    return Records(typed.robots.Mesh, [typed.robots.Mesh.read(one) for one in found])


def set_mesh(
    robot: ResourceReference, link: str, file: str | PathLike[str], *, unit: Literal["mm", "m"] = "mm"
) -> Steps[typed.robots.Mesh]:
    """Give a link its shape, in place of the one it has. It is drawn only.

    Args:
        robot: the robot.
        link: ``"base"``, or the name of the joint that moves the link.
        file: STL or OBJ, in the frame in which the link's mass is stated.
        unit: of the file.

    Raises:
        UsageError: the file is of another kind.
        ApiError: the file is not a mesh, or the robot has no such link.

    """
    path = Path(fspath(file))
    form = FORMS.get(path.suffix.lower())
    if form is None:
        raise UsageError(f"{path}: give a file that ends in .stl or .obj.")
    return typed.robots.Mesh.read(
        (yield from robots.put_mesh(reference("robot", robot), link, path.read_bytes(), form, unit))
    )


def set_urdf_meshes(
    robot: ResourceReference, urdf: str | PathLike[str], *, packages: Mapping[str, str | PathLike[str]] | None = None
) -> Steps[Records[typed.robots.Mesh]]:
    """Give the links of a robot the shapes that its URDF names; needs trimesh.

    Args:
        robot: a robot that was added from a URDF.
        urdf: the URDF's file, beside or below which the files of the shapes lie.
        packages: folders of ROS packages by name.

    Raises:
        FileError: a file is not there, or cannot be read as a mesh.
        ApiError: the robot was not described by a URDF.

    """
    name = reference("robot", robot)
    folders = {package: Path(fspath(folder)) for package, folder in (packages or {}).items()}
    asked = yield from robots.list_urdf_meshes(name)
    made = []
    for one in files_robots.link_meshes(asked["shapes"], Path(fspath(urdf)), folders):
        put = yield from robots.put_mesh(name, one.link, one.content, "stl", "mm")
        made.append(typed.robots.Mesh.read(put))
    return Records(typed.robots.Mesh, made)


def remove_mesh(robot: ResourceReference, link: str) -> Steps[None]:
    """Delete the shape of a link: it is drawn as cylinders again.

    Raises:
        NotFoundError: it has none.

    """
    return (yield from robots.remove_mesh(reference("robot", robot), link))
