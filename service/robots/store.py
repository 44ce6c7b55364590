"""Rows of robots, and what they become in core."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from sqlalchemy import delete, func, select

from service.db import Session
from service.db.tables import ActivationRow, CampaignRow, RobotRow, UploadRow, VersionRow
from service.errors import ServiceError
from service.paging import Page
from service.robots.documents import core_document
from service.robots.records import RobotRecord

if TYPE_CHECKING:
    from core.robot import Robot


class StoredRobot(NamedTuple):
    """A robot's key in the database, its name, and the document it was posted as."""

    id: int
    name: str
    document: dict[str, Any]


def add(session: Session, name: str, document: dict[str, Any]) -> None:
    """Store a robot.

    Raises:
        ServiceError: the name is taken.

    """
    if find(session, name) is not None:
        raise ServiceError(
            f"There is already another robot called {name!r}: give this one its own name, or delete that one.",
            code="robot_exists",
            robot=name,
        )
    session.add(RobotRow(name=name, document=document))
    session.flush()


def find(session: Session, name: str) -> StoredRobot | None:
    """Return the robot of a name, if there is one."""
    row = session.execute(select(RobotRow).where(RobotRow.name == name)).scalar_one_or_none()
    return None if row is None else StoredRobot(row.id, row.name, row.document)


def get(session: Session, name: str) -> StoredRobot:
    """Return the robot of a name.

    Raises:
        ServiceError: there is none.

    """
    found = find(session, name)
    if found is None:
        names = session.execute(select(RobotRow.name).order_by(RobotRow.name)).scalars().all()
        known = f"There are: {', '.join(names)}." if names else "There is none yet: add one with `kilter robot add`."
        raise ServiceError(f"There is no robot {name!r}. {known}", code="robot_not_found", robot=name)
    return found


def by_id(session: Session, robot_id: int) -> StoredRobot:
    """Return the robot of a key that another row refers to."""
    row = session.get_one(RobotRow, robot_id)
    return StoredRobot(row.id, row.name, row.document)


def core_robot(session: Session, robot_id: int) -> Robot:
    """Build core's robot from the stored document."""
    from core.robots import robot_from_document  # imports scipy: not at the start of the API process

    return robot_from_document(core_document(by_id(session, robot_id).document).document)


def remove(session: Session, name: str) -> None:
    """Delete a robot that nothing was measured on.

    Raises:
        ServiceError: there is none, or it has campaigns.

    """
    stored = get(session, name)
    campaigns = _count(session, CampaignRow, stored.id)
    if campaigns or _count(session, VersionRow, stored.id):
        raise ServiceError(
            f"Robot {name!r} has {campaigns} campaigns and cannot be deleted: measurements are kept. "
            "Add a robot of another name instead.",
            code="robot_in_use",
            robot=name,
            campaigns=campaigns,
        )
    staged = select(CampaignRow.id).where(CampaignRow.robot_id == stored.id)
    session.execute(delete(UploadRow).where(UploadRow.campaign_id.in_(staged)))
    session.execute(delete(CampaignRow).where(CampaignRow.robot_id == stored.id))
    session.delete(session.get_one(RobotRow, stored.id))


def listed(session: Session, page: Page) -> list[RobotRecord]:
    """Return robots by name, one more than the page shows."""
    query = select(RobotRow).order_by(RobotRow.name).limit(page.fetched)
    if page.name is not None:
        query = query.where(RobotRow.name > page.name)
    return [_record(session, row) for row in session.execute(query).scalars()]


def record(session: Session, robot_id: int) -> RobotRecord:
    """Return the robot of a key, and how much belongs to it."""
    return _record(session, session.get_one(RobotRow, robot_id))


def _record(session: Session, row: RobotRow) -> RobotRecord:
    last = select(ActivationRow.version_id).where(ActivationRow.robot_id == row.id).order_by(ActivationRow.id.desc())
    return RobotRecord(
        id=row.id,
        name=row.name,
        document=row.document,
        created_at=row.created_at,
        campaigns=_count(session, CampaignRow, row.id),
        versions=_count(session, VersionRow, row.id),
        active_version=session.execute(last.limit(1)).scalar_one_or_none(),
    )


def _count(session: Session, table: type[CampaignRow] | type[VersionRow], robot_id: int) -> int:
    query = select(func.count()).where(table.robot_id == robot_id)
    if table is CampaignRow:
        query = query.where(CampaignRow.staged.is_(False))
    return session.execute(query).scalar_one()
