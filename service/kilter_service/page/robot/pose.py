"""A pose that somebody asks for: what versions say of it, in numbers that people read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kilter_service.ground.called import display_name
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.ground.wire import joint_scale, joint_units, to_mm, to_mm_if_known
from kilter_service.page import words
from kilter_service.page.robot import scene
from kilter_service.robots import service as robots
from kilter_service.versions import service as versions
from kilter_service.versions.predictions import at_pose

if TYPE_CHECKING:
    from kilter_service.versions.predictions.at_pose import AtPose

MOST_JOINTS = 64


@dataclass(frozen=True)
class Part:
    """Something that moves the tool, mm, with the ends of its interval."""

    name: str
    size: float
    low: float | None
    high: float | None


@dataclass(frozen=True)
class Said:
    """What a version says of the pose, mm; ``vector`` is what it moves the tool by."""

    id: str
    name: str
    tool: Sequence[float]
    moved: float
    vector: Sequence[float]
    refused: str
    parts: Sequence[Part]
    missing: Sequence[str]
    sigma: float | None


@dataclass(frozen=True)
class Pose:
    """A pose with what one or two versions say of it; ``row`` is the measured one whose load and directions hold, 0: none."""

    joints: Sequence[str]
    versions: Sequence[Said]
    row: int

    @property
    def largest(self) -> float | None:
        """The largest of the lengths that are compared, mm: all are written in its unit."""
        return words.largest(size for one in self.versions for size in (one.moved, *(part.size for part in one.parts)))


def read(text: str) -> list[float] | None:
    """Read joints as ``10.5,-20,...``, in degrees and mm; None of an empty text.

    Raises:
        ServiceError: one is not a number.

    """
    if not text.strip():
        return None
    try:
        found = [float(part) for part in text.split(",", MOST_JOINTS)]
    except ValueError:
        found = [math.nan]
    if not all(math.isfinite(value) for value in found):
        raise ServiceError(
            f"{text[:60]!r} are not joints: write numbers with commas between, such as 10.5,-20.",
            code="payload_invalid",
        )
    return found


def predict_by_versions(
    database: Database, settings: Settings, robot: str, text: str, chosen: Sequence[str], campaign: str, row: int
) -> Pose:
    """Return what versions say of a pose.

    Raises:
        ServiceError: no such version, campaign or row, or joints of another arm.

    """
    arm, given = robots.arm(database, robot), read(text)
    scale = np.asarray(joint_scale(arm))
    if given is not None and len(given) != len(scale):
        raise ServiceError(f"{robot} has {len(scale)} joints, not {len(given)}.", code="payload_invalid")
    q = None if given is None else np.asarray(given) / scale
    said = []
    for version in dict.fromkeys(filter(None, chosen)):
        scene.check(database, robot, version)
        found = at_pose.at_pose(database, version, q, campaign, row, settings.temperature_c)
        said.append(_moves_of_version(version, display_name(versions.get(database, version)), found))
        q = found.q
    shown = [] if q is None else q * scale
    units = ["mm" if unit == "mm" else "°" for unit in joint_units(arm)]
    joints = [f"{joint.name} {value:.1f}{unit}" for joint, value, unit in zip(arm.joints, shown, units, strict=False)]
    return Pose(joints, said, row if campaign else 0)


def _moves_of_version(version: str, name: str, found: AtPose) -> Said:
    moved = to_mm(found.moved)
    parts = [Part(one.name, to_mm(one.size), to_mm_if_known(one.low), to_mm_if_known(one.high)) for one in found.parts]
    return Said(
        version,
        name,
        to_mm(found.tool).tolist(),
        float(np.linalg.norm(moved)),
        moved.tolist(),
        "" if found.status == "OK" else found.status,
        parts,
        found.missing,
        to_mm_if_known(found.sigma),
    )
