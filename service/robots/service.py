"""What can be done with robots."""

from __future__ import annotations

from service.contract.robot_reports import RobotList, RobotReport
from service.contract.robots import RobotDocument
from service.db import Database
from service.paging import Page
from service.robots import store, wire
from service.robots.documents import core_document


def add(database: Database, document: RobotDocument) -> tuple[RobotReport, bool]:
    """Check and store a robot; the same document twice changes nothing. Returns the report and whether it is new.

    Raises:
        RobotError: the document cannot be an arm.
        ServiceError: the name is taken by another document.

    """
    from core.robots import robot_from_document  # imports scipy: not at the start of the API process

    posted = document.model_dump(mode="json", exclude_none=True)
    robot_from_document(core_document(posted).document)
    with database.transaction() as session:
        found = store.find(session, document.name)
        new = found is None or found.document != posted
        if new:
            store.add(session, document.name, posted)
    return get(database, document.name), new


def get(database: Database, name: str) -> RobotReport:
    """Report on the robot of a name."""
    with database.reading() as session:
        stored = store.get(session, name)
        record = store.record(session, stored.id)
        robot = store.core_robot(session, stored.id)
    return wire.report(record, robot, core_document(stored.document).notes)


def listed(database: Database, page: Page) -> RobotList:
    """List the robots."""
    with database.reading() as session:
        shown, cursor = page.cut(store.listed(session, page), lambda robot: (robot.name,))
    return RobotList(robots=[wire.summary(record) for record in shown], next=cursor)


def remove(database: Database, name: str) -> None:
    """Delete a robot without campaigns."""
    with database.transaction() as session:
        store.remove(session, name)
