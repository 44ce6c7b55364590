"""A mesh as it is stored."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from kilter_service.contract.meshes import MeshUnit


@dataclass(frozen=True)
class MeshRecord:
    """A mesh without its content."""

    link: str
    format: Literal["stl", "obj"]
    unit: MeshUnit
    triangles: int
    sha256: str
    created_at: datetime
