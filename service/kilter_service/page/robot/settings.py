"""What is said of a robot once: what its controller does, its remarks, its description, and the shapes of its links."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from kilter_service.contract.robot_reports import RobotReport
from kilter_service.contract.robots import Mesh
from kilter_service.ground.db import Database
from kilter_service.ground.limits import MAX_MESH_MB, MAX_TRIANGLES
from kilter_service.robots import service as robots
from kilter_service.robots.compensation import WORDS
from kilter_service.robots.meshes import service as meshes


@dataclass(frozen=True)
class Settled:
    """A robot as its settings show it."""

    robot: RobotReport
    meshes: Sequence[Mesh]
    controllers: Mapping[str, str] = field(default_factory=lambda: WORDS)
    most_mb: int = MAX_MESH_MB
    most_triangles: int = MAX_TRIANGLES

    @property
    def links(self) -> list[str]:
        """What may have a shape, from base to tool."""
        return [meshes.BASE, *(joint.name for joint in self.robot.joints)]


def shown_settings(database: Database, name: str) -> Settled:
    """Return what the settings of a robot show."""
    return Settled(robots.get(database, name), meshes.list_meshes(database, name).meshes)
