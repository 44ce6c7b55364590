"""The arm in 3-D as numbers for the browser, mm and degrees in the frame of its base; and a pose that somebody asks for."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_service.campaigns import looking
from kilter_service.campaigns.facts import display_unit_and_factor, meaning
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import display_name
from kilter_service.ground.settings import Settings
from kilter_service.ground.wire import joint_scale, joint_units, to_deg, to_mm, to_mm_if_known
from kilter_service.page import words
from kilter_service.robots import service as robots
from kilter_service.robots.meshes import service as meshes
from kilter_service.versions import service as versions
from kilter_service.versions.predictions import at_pose
from kilter_service.versions.predictions import places as measured

if TYPE_CHECKING:
    from collections.abc import Mapping

    from kilter_core.arm import Robot
    from kilter_service.ground.tables.columns import Column
    from kilter_service.versions.predictions.at_pose import AtPose


Document = dict[str, Any]
NAMES = ("TX", "TY", "TZ", "RX", "RY", "RZ")
FREE = {"deg": 180.0, "mm": 500.0}  # range of a slider of a joint without limits
PLACE, ERROR, ANGLE = 2, 4, 4  # decimals: 0.01 mm, 0.1 µm, 0.0001 degrees


def arm(database: Database, robot: str, version: str = "") -> Document:
    """Return the nominal chain: elements with what moves them, joints with their limits, and the tool in the flange.

    `linkages` are pairs of elements, the axis of a joint and the one that rods tie to it; `identified` are the elements by the
    geometry of a version, null without one.
    """
    found = robots.arm(database, robot)
    units = joint_units(found)
    elements = _elements(found, {})
    identified = _elements(found, measured.geometry(database, version)) if version else None
    joints = []
    for joint, unit, scale in zip(found.joints, units, joint_scale(found), strict=True):
        low, high = (
            round(float(end) * scale, ANGLE) if np.isfinite(end) else sign * FREE[unit]
            for end, sign in ((joint.lower, -1.0), (joint.upper, 1.0))
        )
        joints.append({"name": joint.name, "unit": unit, "low": low, "high": high})
    tool = np.array(found.T_tool, dtype=np.float64)
    tool[:3, 3] = to_mm(tool[:3, 3])
    return {
        "elements": elements,
        "identified": None if identified == elements else identified,
        "joints": joints,
        "primary": list(found.chain.primary),
        "linkages": [
            [found.chain.primary[one.joint], place]
            for place, one in enumerate(found.chain.elements)
            if one.drive == "linkage" and one.joint is not None
        ],
        "tool": np.round(tool, 6).tolist(),
        "meshes": [mesh.link for mesh in meshes.list_meshes(database, robot).meshes],
    }


def _elements(robot: Robot, values: Mapping[str, float]) -> list[list[Any]]:
    """Axis, value, joint and ratio of each element, with other values for some by name."""
    out = []
    for one in robot.chain.elements:
        value = values.get(one.name or "", one.value)
        shown = to_deg(value) if one.axis.rotates else to_mm(value)
        out.append([NAMES[one.axis], round(shown, 6), one.joint, one.ratio])
    return out


def mesh(database: Database, robot: str, link: str) -> bytes:
    """Return the corners of the triangles of a link, nine numbers each, mm, as little-endian floats of 32 bits."""
    return meshes.corners(database, robot, link).astype("<f4").tobytes()


def check(database: Database, robot: str, version: str) -> None:
    """Refuse a version of another robot.

    Raises:
        ServiceError: it is one.

    """
    found = versions.get(database, version).robot
    if found != robot:
        raise ServiceError(
            f"Version {version} is of robot {found!r}: choose one of {robot!r}.", code="option_invalid", version=version
        )


def places(database: Database, version: str, campaign: str) -> Document:
    """Return the measured places with their errors; `total` counts what there is, the lists hold what is shown."""
    found = measured.places(database, version, campaign)
    scale = np.asarray(joint_scale(found.robot))
    return {
        "total": found.total,
        "row": found.row.tolist(),
        "q": np.round(found.q * scale, ANGLE).tolist(),
        "at": np.round(to_mm(found.at), PLACE).tolist(),
        "left": {name: np.round(to_mm(left), ERROR).tolist() for name, left in found.left.items()},
        "columns": [[one.name, _label(one)] for one in looking.columns(database, campaign)],
        "held_out": found.held_out.astype(int).tolist(),
        "set_aside": found.set_aside.astype(int).tolist(),
    }


def _label(column: Column) -> str:
    """Say what a column holds, with its unit."""
    unit = display_unit_and_factor(column)[0]
    return f"{meaning(column)}, {unit}" if unit else meaning(column)


def reach(database: Database, version: str) -> Document:
    """Return poses all over the joint limits: correction of the tool, and the standard deviation of where it is."""
    found = measured.reach(database, version)
    after = None if found.after is None else np.round(to_mm(found.after), ERROR).tolist()
    return {
        "at": np.round(to_mm(found.points), PLACE).tolist(),
        "before": np.round(to_mm(found.before), ERROR).tolist(),
        "after": after,
    }


def worst(database: Database, version: str, campaign: str, most: int = 5) -> Document:
    """Return the rows with the largest errors of a version, the worst first."""
    found = measured.places(database, version, campaign)
    size = to_mm(np.linalg.norm(found.left["identified"], axis=1))
    held = found.held_out if found.held_out.any() else np.ones(len(size), dtype=bool)
    order = [k for k in np.argsort(-size) if held[k]][:most]
    readings = found.q * np.asarray(joint_scale(found.robot))
    return {
        "held_out": bool(found.held_out.any()),
        "joints": [
            f"{joint.name}, {unit}" for joint, unit in zip(found.robot.joints, joint_units(found.robot), strict=True)
        ],
        "rows": [
            {
                "row": int(found.row[k]),
                "error": float(size[k]),
                "at": to_mm(found.at[k]).tolist(),
                "q": [f"{v:.1f}" for v in readings[k]],
            }
            for k in order
        ],
    }


MOST_JOINTS = 64


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
) -> dict[str, Any]:
    """Return what versions say of a pose, mm; ``row`` is the measured one whose load and directions hold, 0: none.

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
        check(database, robot, version)
        found = at_pose.at_pose(database, version, q, campaign, row, settings.temperature_c)
        said.append(_moves_of_version(version, display_name(versions.get(database, version)), found))
        q = found.q
    shown = [] if q is None else q * scale
    units = ["mm" if unit == "mm" else "°" for unit in joint_units(arm)]
    return {
        "joints": [f"{one.name} {value:.1f}{unit}" for one, value, unit in zip(arm.joints, shown, units, strict=False)],
        "versions": said,
        "row": row if campaign else 0,
        "largest": words.largest(
            size for one in said for size in (one["moved"], *(part["size"] for part in one["parts"]))
        ),
    }


def _moves_of_version(version: str, name: str, found: AtPose) -> dict[str, Any]:
    moved = to_mm(found.moved)
    return {
        "id": version,
        "name": name,
        "tool": to_mm(found.tool).tolist(),
        "moved": float(np.linalg.norm(moved)),
        "vector": moved.tolist(),
        "refused": "" if found.status == "OK" else found.status,
        "parts": [
            {"name": one.name, **{end: to_mm_if_known(getattr(one, end)) for end in ("size", "low", "high")}}
            for one in found.parts
        ],
        "missing": found.missing,
        "sigma": to_mm_if_known(found.sigma),
    }
