"""What can be done with robots, their repairs, and instruments."""

from __future__ import annotations

import secrets
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from kilter_service.contract.devices import Instrument, InstrumentList, NewInstrument
from kilter_service.contract.robot_reports import RobotList, RobotReport
from kilter_service.contract.robots import RobotDocument
from kilter_service.contract.today import NewRepair, Repair
from kilter_service.contract.wording import RobotChange, Tombstone
from kilter_service.ground import store as references
from kilter_service.ground.db import Database
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page
from kilter_service.robots import store, wire
from kilter_service.robots.documents import resolve, without_settings

if TYPE_CHECKING:
    from kilter_core.arm import Robot


GOALS = ("tolerance_mm", "check_interval_days")


def add(database: Database, document: RobotDocument) -> tuple[RobotReport, bool]:
    """Check and store a robot; the same document twice changes nothing. Returns the report and whether it is new.

    Whether its controller corrects by itself stands beside the document: another answer makes no other robot.

    Raises:
        RobotError: the document cannot be an arm.
        ServiceError: the name is taken by another document.

    """
    stated = document.controller_compensation
    posted = without_settings(document.model_dump(mode="json", exclude_none=True))
    resolved = resolve(posted)
    with database.transaction() as session:
        found = store.find(session, document.name)
        new = found is None or found.document != posted
        if new:
            store.add(session, document.name, posted, resolved, stated or "unknown")
    report = get(database, document.name)
    if report.sha256 != resolved.sha256:
        report.notes.append(
            "this document gives another arm today: the robot stays what it was when it was added. Add it under another "
            "name to have the new one"
        )
    if stated not in (None, report.controller_compensation):
        report.notes.append(
            f"controller_compensation stays {report.controller_compensation}, as it was set: change it with `kilter robot "
            f"compensation {document.name} {stated}`"
        )
    return report, new


def get(database: Database, name: str) -> RobotReport:
    """Report on the robot of a name."""
    with database.reading() as session:
        stored = store.get(session, name)
        record = store.record(session, stored.id)
    return wire.report(record, stored.robot())


def arm(database: Database, name: str) -> Robot:
    """Return core's robot of a name: its chain, joints and nominal frames, SI."""
    with database.reading() as session:
        return store.get(session, name).robot()


def list_robots(database: Database, page: Page, retired: bool = False) -> RobotList:
    """List the robots; with ``retired`` also those that are out of use."""
    with database.reading() as session:
        shown, cursor = page.cut(store.robots_on_page(session, page, retired), lambda robot: (robot.name,))
    return RobotList(robots=[wire.summary(record) for record in shown], next=cursor)


def change(database: Database, name: str, wanted: RobotChange) -> RobotReport:
    """Change what people say of a robot; what is left out stays, and null takes a goal away."""
    said = wanted.model_dump(exclude_unset=True)
    with database.transaction() as session:
        store.change(session, name, {key: value for key, value in said.items() if value is not None or key in GOALS})
    return get(database, name)


def retire(database: Database, name: str, actor: str) -> RobotReport:
    """Take a robot out of use: no list shows it, nothing new is made of it. The active version keeps correcting."""
    with database.transaction() as session:
        references.retire(session, "robot", store.get(session, name).id, actor)
    return get(database, name)


def restore(database: Database, name: str) -> RobotReport:
    """Bring a robot back into use."""
    with database.transaction() as session:
        references.restore(session, "robot", store.get(session, name).id)
    return get(database, name)


def purge(database: Database, name: str, actor: str) -> Tombstone:
    """Delete a robot without campaigns and versions; its hash is kept."""
    with database.transaction() as session:
        stored = store.get(session, name)
        store.remove(session, name)
        left = Tombstone(id=name, kind="robot", robot=name, name=name, sha256=stored.sha256, by=actor, at=utc_now())
        references.add_tombstone(session, left)
    return left


def add_instrument(database: Database, new: NewInstrument) -> tuple[Instrument, bool]:
    """Store an instrument; the same one twice changes nothing. Returns it and whether it is new.

    Raises:
        ServiceError: the name is taken by another one.

    """
    with database.transaction() as session:
        added = store.add_instrument(session, new)
        return store.get_instrument(session, new.name), added


def list_instruments(database: Database, page: Page) -> InstrumentList:
    """List the instruments, by name."""
    with database.reading() as session:
        shown, cursor = page.cut(store.instruments_on_page(session, page), lambda one: (one.name,))
    return InstrumentList(instruments=shown, next=cursor)


def add_repair(database: Database, robot: str, new: NewRepair, actor: str) -> Repair:
    """Record a repair; the same one twice is one.

    Raises:
        ServiceError: no such robot, one out of use, or a date to come, from which on no check would count.

    """
    now = datetime.now(UTC)
    at = new.at or now
    if at > now:
        raise ServiceError(
            f"The repair is dated {at:%Y-%m-%d %H:%M} UTC, and it is {now:%Y-%m-%d %H:%M}: say when it was done, or leave "
            "the date out for now.",
            code="repair_to_come",
            at=at.isoformat(),
        )
    with database.transaction() as session:
        key = store.usable(session, robot).id
        if new.campaign_id is not None and not store.is_campaign_of(session, key, new.campaign_id):
            raise ServiceError(
                f"{robot} has no campaign {new.campaign_id}: name one of its own.",
                code="option_invalid",
                field="campaign_id",
            )
        for known in store.of_robots(session, [key], new.kind).get(key, []):
            if (known.at, known.what, known.campaign_id, known.rows) == (at, new.what, new.campaign_id, new.rows):
                return known
        return store.add_repair(session, key, f"rep_{secrets.token_hex(8)}", at, new, actor)


def list_notes(database: Database, robot: str, campaign_id: str) -> list[Repair]:
    """Return the notes on a campaign of a robot and on its rows, oldest first."""
    with database.reading() as session:
        key = store.get(session, robot).id
        return [one for one in store.of_robots(session, [key], "note").get(key, []) if one.campaign_id == campaign_id]


def remove_repair(database: Database, robot: str, repair: str) -> None:
    """Delete a repair that was recorded by mistake: its checks count again.

    Raises:
        ServiceError: no such robot or repair.

    """
    with database.transaction() as session:
        store.remove_repair(session, store.get(session, robot).id, repair)
