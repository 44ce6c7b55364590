"""What can be done with robots."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pydantic import TypeAdapter

from service.contract.references import Tombstone
from service.contract.robot_reports import JointSummary, RobotList, RobotReport
from service.contract.robots import RobotDocument
from service.db import Database
from service.db.tables import now
from service.references import retired
from service.references import store as references
from service.robots import store
from service.robots.resolved import resolve

if TYPE_CHECKING:
    from core.robot import Joint

DOCUMENT: TypeAdapter[RobotDocument] = TypeAdapter(RobotDocument)


def add(database: Database, document: RobotDocument) -> tuple[RobotReport, bool]:
    """Check and store a robot; the same document twice changes nothing. Returns the report and whether it is new.

    Raises:
        RobotError: the document cannot be an arm.
        ServiceError: the name is taken by another document.

    """
    posted = document.model_dump(mode="json", exclude_none=True)
    resolved = resolve(posted)
    with database.transaction() as session:
        found = store.find(session, document.name)
        new = found is None or found.document != posted
        if new:
            store.add(session, document.name, posted, resolved)
    report = get(database, document.name)
    if report.sha256 != resolved.sha256:
        report.notes.append(
            "this document gives another arm today: the robot stays what it was when it was added. Add it under another "
            "name to have the new one"
        )
    return report, new


def get(database: Database, name: str) -> RobotReport:
    """Report on the robot of a name."""
    with database.reading() as session:
        stored = store.get(session, name)
        summary = store.summaries(session, name)[0]
    robot = stored.robot()
    return RobotReport(
        **summary.model_dump(),
        joints=[joint_summary(joint) for joint in robot.joints],
        parameters=[str(robot.chain.elements[k].name) for k in robot.chain.named],
        notes=stored.notes,
        sha256=stored.sha256,
        source_sha256=stored.source_sha256,
        document=DOCUMENT.validate_python(stored.document),
    )


def listed(database: Database, with_retired: bool = False) -> RobotList:
    """List the robots, perhaps also those that are out of use."""
    with database.reading() as session:
        return RobotList(robots=store.summaries(session, retired=with_retired))


def remark(database: Database, name: str, remarks: str) -> RobotReport:
    """Note something on a robot."""
    with database.transaction() as session:
        store.row_of(session, store.get(session, name).id).remarks = remarks
    return get(database, name)


def retire(database: Database, name: str, actor: str) -> RobotReport:
    """Take a robot out of use: no list shows it, nothing new is made of it. What is active goes on correcting."""
    with database.transaction() as session:
        retired.retire(store.row_of(session, store.get(session, name).id), actor)
    return get(database, name)


def restore(database: Database, name: str) -> RobotReport:
    """Bring a robot back into use."""
    with database.transaction() as session:
        retired.restore(store.row_of(session, store.get(session, name).id))
    return get(database, name)


def purge(database: Database, name: str, actor: str) -> Tombstone:
    """Delete a robot without campaigns and versions; its hash is kept."""
    with database.transaction() as session:
        stored = store.get(session, name)
        store.remove(session, name)
        tombstone = Tombstone(
            id=name, kind="robot", robot=name, name=name, sha256=stored.sha256, by=actor, at=now()
        )  # fmt: skip
        references.bury(session, tombstone)
    return tombstone


def joint_summary(joint: Joint) -> JointSummary:
    """Say what a joint is, in mm and degrees."""
    bounds = tuple(bound if math.isfinite(bound) else None for bound in (joint.lower, joint.upper))
    scale = 1e3 if joint.kind == "prismatic" else 180.0 / math.pi
    limits = tuple(None if bound is None else round(bound * scale, 9) for bound in bounds)
    if joint.kind == "prismatic":
        return JointSummary(name=joint.name, kind="prismatic", limits_mm=limits, gear_ratio=joint.gear_ratio)
    return JointSummary(name=joint.name, kind="revolute", limits_deg=limits, gear_ratio=joint.gear_ratio)
