"""Rows of robots, of instruments and of repairs, and what they become in core."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from sqlalchemy import Select, delete, func, select

from kilter_service.contract.devices import Instrument, NewInstrument
from kilter_service.contract.today import NewRepair, Repair, RepairKind
from kilter_service.contract.units import ControllerCompensation
from kilter_service.contract.wording import Remark
from kilter_service.ground import store as references
from kilter_service.ground.caller import allowed_robots, may_see
from kilter_service.ground.core import core_arm, core_evaluate
from kilter_service.ground.db import Session
from kilter_service.ground.db.tables import (
    ActivationRow,
    CampaignRow,
    InstrumentRow,
    JobRow,
    RepairRow,
    RobotRow,
    UploadRow,
    VersionRow,
)
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import copy_fields
from kilter_service.ground.paging import Page
from kilter_service.ground.wire import from_um
from kilter_service.robots.compensation import parse_compensation
from kilter_service.robots.documents import Resolved

if TYPE_CHECKING:
    from kilter_core.arm import Robot


Belonging = TypeVar("Belonging", CampaignRow, VersionRow, JobRow)
Query = TypeVar("Query", bound="Select[*tuple[Any, ...]]")


class StoredRobot(NamedTuple):
    """A robot's key in the database, its name, the document it was posted as, and the chain that represents it.

    ``chain`` is None for a robot from before the chains that no longer resolves.
    """

    id: int
    name: str
    document: dict[str, Any]
    chain: dict[str, Any] | None
    sha256: str
    source_sha256: str
    notes: list[str]
    controller_compensation: str = "unknown"

    def robot(self) -> Robot:
        """Build core's robot from the chain, whatever the document would be resolved to today.

        Raises:
            ServiceError: there is no chain.

        """
        if self.chain is None:
            raise ServiceError(
                f"Robot {self.name!r} was stored by an earlier Kilter, and its document could not be resolved when the "
                "database was migrated (the log of that start says why): add the robot again under another name.",
                code="robot_invalid",
                robot=self.name,
            )
        return core_arm.robot_from_resolved(self.name, self.chain)


def add(
    session: Session, name: str, document: dict[str, Any], resolved: Resolved, compensation: str = "unknown"
) -> None:
    """Store a robot with what it was resolved to, and whether its controller corrects by itself.

    Raises:
        ServiceError: the name is taken.

    """
    if not may_see(name):
        raise ServiceError(
            f"This token is limited to robots {', '.join(sorted(allowed_robots() or ()))}: use one that is not, or one that "
            f"names {name!r}.",
            code="token_limited",
            robot=name,
        )
    if find(session, name) is not None:
        raise ServiceError(
            f"There is already another robot called {name!r}: give this one its own name, or delete that one.",
            code="robot_exists",
            robot=name,
        )
    session.add(
        RobotRow(
            name=name,
            document=document,
            chain=resolved.chain,
            sha256=resolved.sha256,
            source_sha256=resolved.source_sha256,
            left_out=resolved.notes,
            controller_compensation=compensation,
        )
    )
    session.flush()


def find(session: Session, name: str) -> StoredRobot | None:
    """Return the robot of a name, if there is one that the caller may see."""
    if not may_see(name):
        return None
    row = session.execute(select(RobotRow).where(RobotRow.name == name)).scalar_one_or_none()
    return None if row is None else _robot_from_row(row)


def _robot_from_row(row: RobotRow) -> StoredRobot:
    return copy_fields(StoredRobot, row, notes=[str(note) for note in row.left_out])


def get(session: Session, name: str) -> StoredRobot:
    """Return the robot of a name.

    Raises:
        ServiceError: there is none.

    """
    found = find(session, name)
    if found is None:
        in_use = select(RobotRow.name).where(RobotRow.retired_at.is_(None)).order_by(RobotRow.name)
        names = session.execute(visible(in_use)).scalars().all()
        known = f"There are: {', '.join(names)}." if names else "There is none yet: add one with `kilter robot add`."
        raise ServiceError(f"There is no robot {name!r}. {known}", code="robot_not_found", robot=name)
    return found


def visible(query: Query) -> Query:
    """Leave out of a query that has robots those that the caller may not see."""
    robots = allowed_robots()
    return query if robots is None else query.where(RobotRow.name.in_(robots))


def names_by_key(session: Session, name: str | None) -> dict[int, str]:
    """Return the robots that are asked for, by their keys: the one of a name, or all in use that may be seen."""
    if name is not None:
        found = get(session, name)
        return {found.id: found.name}
    query = visible(select(RobotRow.id, RobotRow.name).where(RobotRow.retired_at.is_(None)))
    return dict(session.execute(query).all())


def visible_row(session: Session, table: type[Belonging], id_: str, listed: str) -> Belonging:
    """Return a campaign, version or job of a robot that the caller may see.

    Raises:
        ServiceError: there is none; it names the request by which they are ``listed``.

    """
    row = session.get(table, id_)
    if row is None or not (allowed_robots() is None or may_see(session.get_one(RobotRow, row.robot_id).name)):
        kind = next(kind for kind, rows in references.TABLES.items() if rows is table)
        raise ServiceError(
            f"There is no {kind} {id_!r}: list them with {listed}." + references.gone(session, kind, id_),
            code=f"{kind}_not_found",
            **{kind: id_},
        )
    return row


def usable(session: Session, name: str) -> StoredRobot:
    """Return the robot of a name, if it is in use.

    Raises:
        ServiceError: there is none, or it is retired.

    """
    found = get(session, name)
    refuse_retired_robot(session, found.id)
    return found


def refuse_retired_robot(session: Session, robot_id: int) -> None:
    """Refuse to work with a robot that is retired.

    Raises:
        ServiceError: it is.

    """
    row = session.get_one(RobotRow, robot_id)
    references.refuse_retired("robot", row.name, row.retired_at)


def change(session: Session, name: str, settings: Mapping[str, Any]) -> None:
    """Set columns of a robot: what people note, what its controller corrects, how good it must be."""
    row = _row(session, name)
    for column, value in settings.items():
        setattr(row, column, value)


def goals(session: Session, of: Collection[int]) -> dict[int, tuple[float | None, int | None]]:
    """Return tolerance, mm, and days between checks of robots; None: not stated."""
    row = RobotRow
    query = select(row.id, row.tolerance_mm, row.check_interval_days).where(row.id.in_(of))
    return {key: (tolerance, days) for key, tolerance, days in session.execute(query)}


def get_compensation(session: Session, robot_id: int) -> str:
    """Return whether the controller of a robot corrects by itself."""
    return session.get_one(RobotRow, robot_id).controller_compensation


def robots_with_compensation(session: Session, values: Collection[str]) -> frozenset[str]:
    """Return the names of the robots whose controllers correct in one of these ways."""
    return frozenset(session.execute(query_for_compensated(values)).scalars())


def query_for_compensated(values: Collection[str]) -> Select[str]:
    """Return the query for `compensated`, in a fixed order."""
    return select(RobotRow.name).where(RobotRow.controller_compensation.in_(values)).order_by(RobotRow.name)


def _row(session: Session, name: str) -> RobotRow:
    return session.get_one(RobotRow, get(session, name).id)


def names(session: Session, robot_ids: Collection[int]) -> dict[int, str]:
    """Return the names of robots by their keys."""
    return dict(session.execute(select(RobotRow.id, RobotRow.name).where(RobotRow.id.in_(robot_ids))).all())


def by_id(session: Session, robot_id: int) -> StoredRobot:
    """Return the robot of a key that another row refers to."""
    return _robot_from_row(session.get_one(RobotRow, robot_id))


def count_version(session: Session, robot_id: int) -> int:
    """Count one more version of a robot, and return its number."""
    row = session.get_one(RobotRow, robot_id)
    row.versions_made += 1
    return row.versions_made


def others_in_use(session: Session, robot_id: int) -> list[StoredRobot]:
    """Return the other robots in use that the caller may see, oldest first."""
    query = select(RobotRow).where(RobotRow.id != robot_id, RobotRow.retired_at.is_(None)).order_by(RobotRow.id)
    return [_robot_from_row(row) for row in session.execute(visible(query)).scalars()]


def core_robot(session: Session, robot_id: int) -> Robot:
    """Build core's robot from the stored chain."""
    return by_id(session, robot_id).robot()


def remove(session: Session, name: str) -> None:
    """Delete a robot that nothing was measured on.

    Raises:
        ServiceError: there is none, or it has campaigns.

    """
    stored = get(session, name)
    had = record(session, stored.id)
    if had.campaigns or had.versions:
        raise ServiceError(
            f"Robot {name!r} has {had.campaigns} campaigns and cannot be deleted: measurements are kept. "
            f"Retire it instead (kilter robot retire {name}), or purge its versions and campaigns first.",
            code="robot_in_use",
            robot=name,
            campaigns=had.campaigns,
        )
    staged = select(CampaignRow.id).where(CampaignRow.robot_id == stored.id)
    session.execute(delete(UploadRow).where(UploadRow.campaign_id.in_(staged)))
    session.execute(delete(CampaignRow).where(CampaignRow.robot_id == stored.id))
    session.delete(session.get_one(RobotRow, stored.id))


def robots_on_page(session: Session, page: Page, with_retired: bool = False) -> list[RobotRecord]:
    """Return robots by name, one more than the page shows; those out of use only when they are asked for."""
    query = visible(_records()).order_by(RobotRow.name).limit(page.fetch_limit)
    if not with_retired:
        query = query.where(RobotRow.retired_at.is_(None))
    if page.name is not None:
        query = query.where(RobotRow.name > page.name)
    return [_record(*found) for found in session.execute(query)]


def record(session: Session, robot_id: int) -> RobotRecord:
    """Return the robot of a key, and how much belongs to it."""
    return _record(*session.execute(_records().where(RobotRow.id == robot_id)).one())


def _records() -> Select[RobotRow, int, int, str | None]:
    """Robots with how many campaigns and versions they have, and the version in use."""
    campaigns = select(func.count()).where(CampaignRow.robot_id == RobotRow.id, CampaignRow.staged.is_(False))
    versions = select(func.count()).where(VersionRow.robot_id == RobotRow.id)
    activations = select(ActivationRow.version_id).where(ActivationRow.robot_id == RobotRow.id)
    last = activations.order_by(ActivationRow.id.desc()).limit(1)
    return select(RobotRow, campaigns.scalar_subquery(), versions.scalar_subquery(), last.scalar_subquery())


def _record(row: RobotRow, campaigns: int, versions: int, active_version: str | None) -> RobotRecord:
    return copy_fields(
        RobotRecord,
        row,
        campaigns=campaigns,
        versions=versions,
        active_version=active_version,
        controller_compensation=parse_compensation(row.controller_compensation),
        notes=[str(note) for note in row.left_out],
    )


@dataclass(frozen=True)
class RobotRecord:
    """A stored robot, and how much belongs to it. ``sha256`` is that of its chain, ``source_sha256`` that of the document.

    ``notes`` say what of the document the chain leaves out, ``remarks`` what people noted.
    """

    id: int
    name: str
    document: dict[str, Any]
    created_at: datetime
    campaigns: int
    versions: int
    active_version: str | None
    remarks: str
    controller_compensation: ControllerCompensation
    tolerance_mm: float | None
    check_interval_days: int | None
    retired_at: datetime | None
    notes: list[str]
    sha256: str
    source_sha256: str


def add_instrument(session: Session, new: NewInstrument) -> bool:
    """Store an instrument; the same one twice changes nothing. Returns whether it is new.

    Raises:
        ServiceError: the name is taken by another one.

    """
    found = session.get(InstrumentRow, new.name)
    if found is None:
        session.add(InstrumentRow(**new.model_dump(mode="json")))
        session.flush()
        return True
    if NewInstrument(**_fields(found)) != new:
        raise ServiceError(
            f"There is already another instrument {new.name!r}, or the same with another certificate: what was measured with "
            f"it keeps that. Add this one under another name, as {new.name}-2.",
            code="instrument_exists",
            instrument=new.name,
        )
    return False


def get_instrument(session: Session, name: str) -> Instrument:
    """Return the instrument of a name.

    Raises:
        ServiceError: there is none.

    """
    found = of_names(session, [name]).get(name)
    if found is None:
        names = session.execute(select(InstrumentRow.name).order_by(InstrumentRow.name)).scalars().all()
        known = (
            f"There are: {', '.join(names)}."
            if names
            else "There is none yet: add it with `kilter measure instrument add`."
        )
        raise ServiceError(f"There is no instrument {name!r}. {known}", code="instrument_not_found", instrument=name)
    return found


def of_names(session: Session, names: Collection[str]) -> dict[str, Instrument]:
    """Return the instruments of these names that there are."""
    if not names:
        return {}
    rows = session.execute(select(InstrumentRow).where(InstrumentRow.name.in_(names))).scalars()
    return {row.name: _instrument(row) for row in rows}


def instruments_on_page(session: Session, page: Page) -> list[Instrument]:
    """Return instruments by name, one more than the page shows."""
    query = select(InstrumentRow).order_by(InstrumentRow.name).limit(page.fetch_limit)
    if page.name is not None:
        query = query.where(InstrumentRow.name > page.name)
    return [_instrument(row) for row in session.execute(query).scalars()]


def _fields(row: InstrumentRow) -> dict[str, Any]:
    return {name: getattr(row, name) for name in NewInstrument.model_fields}


def _instrument(row: InstrumentRow) -> Instrument:
    return Instrument(**_fields(row), created_at=row.created_at)


def remarks(instrument: Instrument | None, measured_at: datetime | None, stored_at: datetime) -> list[Remark]:
    """Say what a certificate has against a campaign; where nobody stated when it was measured, the day it was stored counts."""
    if instrument is None:
        return []
    day = (measured_at or stored_at).date()
    when = f"the campaign was measured on {day}" if measured_at else f"the campaign was stored on {day}"
    name, until, since = instrument.name, instrument.valid_until, instrument.certified_on
    if until is not None and day > until:
        message = (
            f"The certificate of instrument {name} held until {until}, and {when}: its permissible error is not shown for that "
            "day. Have it calibrated, add it with the new certificate under another name, and measure again."
        )
        return [Remark(code="instrument_expired", message=message)]
    if since is not None and day < since:
        message = (
            f"The certificate of instrument {name} is of {since}, and {when}, before it: name the instrument with the "
            "certificate that held then."
        )
        return [Remark(code="instrument_not_yet_certified", message=message)]
    return []


def permissible(instrument: Instrument | None) -> Any:
    """Return an instrument's permissible error as core has it; None without one."""
    if instrument is None:
        return None
    return core_evaluate.PermissibleError(from_um(instrument.mpe_um), from_um(instrument.mpe_um_per_m))


def add_repair(session: Session, robot_id: int, key: str, at: datetime, new: NewRepair, actor: str) -> Repair:
    """Store a repair or a note."""
    place = {"kind": new.kind, "campaign_id": new.campaign_id, "rows": new.rows}
    row = RepairRow(id=key, robot_id=robot_id, at=at, what=new.what, actor=actor, **place)
    session.add(row)
    session.flush()
    return _repair(row)


def remove_repair(session: Session, robot_id: int, key: str) -> None:
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
