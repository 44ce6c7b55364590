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


class MeshList(Listed):
    """The shapes of a robot's links, from base to tool."""

    meshes: list[Mesh] = Field(description="Shapes, from base to tool.")
