"""The shapes that a robot's URDF names, as one STL file (mm) for each link of the arm."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kilter_files.ground.errors import FileError, fault
from kilter_files.ground.later import need

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
