"""Rows of repairs."""

from __future__ import annotations

from collections.abc import Collection
from datetime import datetime

from sqlalchemy import select

from kilter_service.contract.drift import NewRepair, Repair, RepairKind
from kilter_service.ground.by_name import copy_fields
from kilter_service.ground.db import Session
from kilter_service.ground.db.tables import CampaignRow, RepairRow
from kilter_service.ground.errors import ServiceError


def add(session: Session, robot_id: int, key: str, at: datetime, new: NewRepair, actor: str) -> Repair:
    """Store a repair or a note."""
    place = {"kind": new.kind, "campaign_id": new.campaign_id, "rows": new.rows}
    row = RepairRow(id=key, robot_id=robot_id, at=at, what=new.what, actor=actor, **place)
    session.add(row)
    session.flush()
    return _repair(row)


def remove(session: Session, robot_id: int, key: str) -> None:
    """Delete a repair.

    Raises:
        ServiceError: there is none.

    """
    row = session.get(RepairRow, key)
    if row is None or row.robot_id != robot_id:
        raise ServiceError(
            f"The robot has no repair {key!r}: its drift history lists them (kilter watch drift ROBOT).",
            code="repair_not_found",
            repair=key,
        )
    session.delete(row)


def of_robots(session: Session, robots: Collection[int], kind: RepairKind = "repair") -> dict[int, list[Repair]]:
    """Return the repairs, or the notes, of robots, oldest first."""
    row = RepairRow
    query = select(row).where(row.robot_id.in_(robots), row.kind == kind).order_by(row.at, row.created_at, row.id)
    out: dict[int, list[Repair]] = {}
    for one in session.execute(query).scalars():
        out.setdefault(one.robot_id, []).append(_repair(one))
    return out


def is_campaign_of(session: Session, robot_id: int, campaign_id: str) -> bool:
    """Whether a campaign is of this robot."""
    query = select(CampaignRow.id).where(CampaignRow.id == campaign_id, CampaignRow.robot_id == robot_id)
    return session.execute(query).scalar() is not None


def last_repair(session: Session, robot_id: int) -> Repair | None:
    """Return the last repair of a robot; None: none is known."""
    return next(reversed(of_robots(session, [robot_id]).get(robot_id, [])), None)


def _repair(row: RepairRow) -> Repair:
    return copy_fields(Repair, row, by=row.actor)
