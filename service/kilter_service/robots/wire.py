"""Robots as they go over the wire."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from pydantic import TypeAdapter

from kilter_service.contract.robot_reports import JointSummary, RobotReport, RobotSummary
from kilter_service.contract.robots import RobotDocument
from kilter_service.ground.wire import DEG, MM
from kilter_service.robots.compensation import statement
from kilter_service.robots.drives import notes_on_missing_directions, said_of_drives
from kilter_service.robots.records import RobotRecord

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
