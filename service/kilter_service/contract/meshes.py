"""Shapes of a robot's links, for the picture of the arm."""

from __future__ import annotations

from datetime import datetime
from typing import Literal

from pydantic import Field

from kilter_service.contract.units import Listed, Strict

MeshUnit = Literal["mm", "m"]


class Mesh(Strict):
    """The shape of a link. It is drawn only: no load and no identification uses it."""

    robot: str = Field(description="Name of the robot.")
    link: str = Field(description="Name of the joint that moves the link, or `base`.")
    format: Literal["stl", "obj"] = Field(description="Format of the file.")
    unit: MeshUnit = Field(description="Unit of the coordinates of the file: mm or m.")
    triangles: int = Field(description="Number of triangles.")
    sha256: str = Field(description="SHA-256 of the file, 64 hexadecimal digits.")
    created_at: datetime = Field(description="When it was stored.")


class UrdfShape(Strict):
    """A shape that the robot's URDF gives a link: a file, or a box, cylinder or sphere."""

    link: str = Field(description="Name of the joint that moves the link, or `base`.")
    urdf_link: str = Field(description="The URDF's name of the link.")
    file: str | None = Field(
        None, description="File of the mesh, in the URDF's words; null: a body of the sizes below."
    )
    scale: tuple[float, float, float] = Field((1.0, 1.0, 1.0), description="Factors of the file's coordinates to m.")
    box_mm: tuple[float, float, float] | None = Field(None, description="Sizes of a box about its centre, mm.")
    cylinder_mm: tuple[float, float] | None = Field(
        None, description="Radius and length of a cylinder along z about its centre, mm."
    )
    sphere_mm: float | None = Field(None, description="Radius of a sphere, mm.")
    transform: list[list[float]] = Field(
        description="Rows (4 by 4) that take the shape's own coordinates in mm to those of the link's mesh."
    )


class UrdfShapes(Strict):
    """What the robot's URDF draws of the arm."""

    shapes: list[UrdfShape] = Field(description="Shapes, from base to tool.")
    left_out: list[str] = Field(description="The URDF's links behind joints that follow another: they have no mesh.")


class MeshList(Listed):
    """The shapes of a robot's links, from base to tool."""

    meshes: list[Mesh] = Field(description="Shapes, from base to tool.")
