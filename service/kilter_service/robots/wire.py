"""Robots as they go over the wire."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from pydantic import TypeAdapter

from kilter_service.contract.robot_reports import JointSummary, RobotReport, RobotSummary
from kilter_service.contract.robots import RobotDocument
from kilter_service.ground.core import core_model
from kilter_service.ground.wire import DEG, MM
from kilter_service.robots.compensation import statement
from kilter_service.robots.store import RobotRecord

if TYPE_CHECKING:
    from kilter_core.arm import Joint, Robot


DOCUMENT: TypeAdapter[RobotDocument] = TypeAdapter(RobotDocument)


def summary(record: RobotRecord) -> RobotSummary:
    """Say what lists tell of a robot."""
    return RobotSummary(**_summary_fields(record))


def report(record: RobotRecord, robot: Robot) -> RobotReport:
    """Say all of a robot, as it was posted and as core has it."""
    return RobotReport(
        **_summary_fields(record),
        joints=[joint_summary(joint) for joint in robot.joints],
        parameters=[str(robot.chain.elements[k].name) for k in robot.chain.named_elements],
        notes=[*record.notes, *notes_on_missing_directions(robot)],
        drives=said_of_drives(robot),
        sha256=record.sha256,
        source_sha256=record.source_sha256,
        document=DOCUMENT.validate_python(
            {**record.document, "controller_compensation": record.controller_compensation}
        ),
    )


def _summary_fields(record: RobotRecord) -> dict[str, Any]:
    return {
        "name": record.name,
        "convention": record.document["convention"],
        "created_at": record.created_at,
        "campaigns": record.campaigns,
        "versions": record.versions,
        "active_version": record.active_version,
        "remarks": record.remarks,
        "controller_compensation": record.controller_compensation,
        "controller_sentence": statement(record.name, record.controller_compensation),
        "tolerance_mm": record.tolerance_mm,
        "check_interval_days": record.check_interval_days,
        "retired_at": record.retired_at,
    }


def joint_summary(joint: Joint) -> JointSummary:
    """Say what a joint is, in mm and degrees."""
    bounds = tuple(bound if math.isfinite(bound) else None for bound in (joint.lower, joint.upper))
    scale = MM if joint.kind == "prismatic" else DEG
    limits = tuple(None if bound is None else round(bound * scale, 9) for bound in bounds)
    if joint.kind == "prismatic":
        return JointSummary(name=joint.name, kind="prismatic", limits_mm=limits, gear_ratio=joint.gear_ratio)
    return JointSummary(
        name=joint.name,
        kind="revolute",
        limits_deg=limits,
        gear_ratio=joint.gear_ratio,
        drive_stiffness_nm_rad=joint.drive_stiffness,
    )


BY = {
    "controller": "because the controller moves its motor along",
    "series": "through gears of its own in series",
}

ERRORS = (
    " A deflection or error of the gear of {joint} counts as moving axis {number} by its ratio too, as with a linkage."
)


def said_of_drives(robot: Robot) -> list[str]:
    """Return a sentence for each axis that follows a joint and of which the document says who carries its load."""
    out = []
    for element, number, joint, own, ratio in _followers(robot):
        drive = robot.chain.elements[element].drive
        if drive == "linkage":
            share = f"{robot.chain.linkage_load_ratio(element):+.6g} times that on axis {number}"
            out.append(
                f"Axis {number} follows {joint} (ratio {ratio:g}) by a linkage: the gear of {joint} carries the load on axis "
                f"{own} and {share}."
            )
        elif drive is not None:
            out.append(
                f"Axis {number} follows {joint} (ratio {ratio:g}) {BY[drive]}: the gear of {joint} carries the load on axis "
                f"{own} alone.{ERRORS.format(joint=joint, number=number) if drive == 'controller' else ''}"
            )
    return out


def unsaid_drives(robot: Robot) -> Iterator[str]:
    """Say of which axes nobody says who carries their load, and what that means."""
    for element, number, joint, own, ratio in _followers(robot):
        if robot.chain.elements[element].drive is None:
            yield (
                f"Axis {number} follows {joint} (ratio {ratio:g}), and the document does not say who carries its load: the "
                f"gear of {joint} counts as carrying the load on axis {own} alone. Say it with drive: linkage (rods, a "
                "parallelogram driven from the base), controller, or series."
            )


def _followers(robot: Robot) -> Iterator[tuple[int, int, str, int, float]]:
    """Yield element, number of the axis from 1, name of the joint, number of that joint's own axis, and ratio."""
    chain = robot.chain
    for k in chain.followers:
        joint = chain.elements[k].joint
        assert joint is not None
        own = chain.driven.index(chain.primary[joint]) + 1
        yield k, chain.driven.index(k) + 1, robot.joints[joint].name, own, chain.elements[k].ratio


def notes_on_missing_directions(robot: Robot) -> list[str]:
    """Return which joints lack a direction of their axis' error, and how to get it; empty where none does."""
    missing = core_model.missing_directions(robot)
    lacking = [f"{joint.name} ({count})" for joint, count in zip(robot.joints, missing.tolist(), strict=True) if count]
    if not lacking:
        return []
    return [
        f"Directions in which an axis may be off and no parameter says so: {', '.join(lacking)}. Errors there stay. To have "
        "all, convert the robot (`kilter robot convert FILE --to mcpc`) and add it under another name; of a URDF, add the "
        "file itself again."
    ]
