"""What can be done with campaigns and their observations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import TypeAdapter

from kilter_core.errors import FindingDocument, ObservationError
from kilter_core.observations import SINCE_1970_S
from kilter_files.ground.later import pc
from kilter_service.campaigns import store
from kilter_service.campaigns.belonging import judged_whole
from kilter_service.campaigns.row_rules import RowRules, payload_warning
from kilter_service.campaigns.store import CampaignRecord, Chunk, UploadRecord, write_chunk
from kilter_service.campaigns.view_rules import views_rules
from kilter_service.contract.campaigns import (
    Campaign,
    CampaignList,
    CheckedRows,
    Conditions,
    NewCampaign,
    Parts,
    Upload,
    Uploaded,
)
from kilter_service.contract.columns import CONTACTS, TILTS
from kilter_service.contract.devices import Instrument
from kilter_service.contract.wording import Remark
from kilter_service.ground import store as retired
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import copy_fields
from kilter_service.ground.paging import Page, in_time
from kilter_service.ground.tables import reading
from kilter_service.ground.tables.assemble import rig_from_conditions
from kilter_service.ground.tables.columns import has, read_columns
from kilter_service.ground.tables.reading import Names
from kilter_service.ground.tables.writing import write_table
from kilter_service.robots import store as robots
from kilter_service.robots.store import remarks
from kilter_service.web.routing import NOT_REPEATED, Once, hash_document

if TYPE_CHECKING:
    from kilter_core.arm import Robot


STAGED_FOR = timedelta(days=7)
AHEAD = timedelta(hours=1)  # by which the clock of whoever measured may be fast
Checked = tuple[list[Chunk], tuple[FindingDocument, ...]]
CAMPAIGN, UPLOADED = TypeAdapter(Campaign), TypeAdapter(Uploaded)
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")  # all six may be readings of a force sensor
MEASURED = ("x", "marker_x", "link", "pixel_u", "tau", *TILTS, *CONTACTS)

TIME = "t_s"

CONDITION = "calibration_sha256"


def add(database: Database, robot: str, campaign: NewCampaign, once: Once = NOT_REPEATED) -> Campaign:
    """Store a new campaign of a robot; an unfinished one from long ago is deleted meanwhile.

    Raises:
        ObservationError: cameras or boards that cannot be.
        ServiceError: no such robot or instrument, a name that is taken or invalid, a day in the future, or servos with
            another calibration than the robot's other campaigns.

    """
    body = hash_document(campaign)
    with database.transaction() as session:
        known = once.first_answer(session, body, CAMPAIGN)
        if known is not None:
            return known
        robot_id = robots.usable(session, robot).id
        _refuse_unfit(session, robot_id, robot, campaign)
        for forgotten in store.staged_before(session, robot_id, datetime.now(UTC) - STAGED_FOR):
            store.discard(session, forgotten)
        campaign_id = store.add(session, robot_id, campaign)
        session.flush()
        return once.keep(session, body, load_campaign(session, campaign_id))


def _refuse_unfit(session: Session, robot_id: int, robot: str, campaign: NewCampaign) -> None:
    """Refuse a campaign that cannot be made, whatever its name and its rows."""
    _refuse_future(campaign)
    rig_from_conditions(campaign.conditions.model_dump(mode="json", exclude_none=True))
    if campaign.instrument is not None:
        robots.get_instrument(session, campaign.instrument)
    refuse_other_zeros(session, robot_id, robot, campaign.name, campaign.conditions.model_dump())


def _refuse_future(campaign: NewCampaign) -> None:
    at = campaign.measured_at
    if at is not None and at > datetime.now(UTC) + AHEAD:
        raise ServiceError(
            f"measured_at {at.isoformat()} is in the future: give the time at which the last row was measured, or leave it "
            "out. Is the clock of this machine right?",
            code="payload_invalid",
            field="measured_at",
        )


def get(database: Database, campaign_id: str) -> Campaign:
    """Return a campaign."""
    with database.reading() as session:
        return load_campaign(session, campaign_id)


def rows(database: Database, campaign_id: str, media: str) -> bytes:
    """Return the rows of a campaign as they were uploaded, as CSV, Parquet or JSON.

    Raises:
        ObservationError: nothing was uploaded yet.

    """
    with database.reading() as session:
        load_campaign(session, campaign_id)
        table = store.table(session, campaign_id)
    return write_table(table, media)


def commit(database: Database, campaign_id: str, parts: Parts) -> Campaign:
    """Make a staged campaign visible, at once and only if it holds exactly the parts that are named.

    Raises:
        ObservationError: together the parts look mixed up, which each of them did not show.
        ServiceError: no such campaign, or other parts than those named.

    """
    _refuse_mixed_up(database, campaign_id, parts)
    with database.transaction() as session:
        store.get(session, campaign_id)
        there, named = {upload.sha256 for upload in store.uploads_of_campaign(session, campaign_id)}, set(parts.sha256)
        if there != named:
            raise ServiceError(
                f"Campaign {campaign_id} lacks {len(named - there)} of {len(named)} parts and has {len(there - named)} "
                "others: send what is missing, or discard it and start again.",
                code="campaign_incomplete",
                missing=sorted(named - there)[:20],
                others=sorted(there - named)[:20],
            )
        refuse_other_servos(session, campaign_id)
        store.commit(session, campaign_id)
        date_by_stamps(session, campaign_id)
        session.flush()
        return load_campaign(session, campaign_id)


def discard(database: Database, campaign_id: str) -> None:
    """Delete a staged campaign with all that was sent to it.

    Raises:
        ServiceError: no such campaign, or one that is not staged: measurements are kept.

    """
    with database.transaction() as session:
        if not store.get(session, campaign_id).staged:
            raise ServiceError(
                f"Campaign {campaign_id} is whole: measurements are kept. Use another one.", code="campaign_committed"
            )
        store.discard(session, campaign_id)


def list_campaigns(
    database: Database, robot: str, page: Page, staged: bool = False, with_retired: bool = False
) -> CampaignList:
    """List the campaigns of a robot, or those whose parts are not all there yet; ``with_retired`` those out of use too."""
    with database.reading() as session:
        owner = robots.get(session, robot)
        read = store.campaigns_on_page(session, owner.id, staged, page, with_retired)
        found, cursor = page.cut(read, lambda campaign: in_time(campaign.created_at, campaign.id))
        uploads = store.uploads_of_all(session, [campaign.id for campaign in found])
        used = robots.of_names(session, {one.instrument for one in found if one.instrument})
    shown_ones = [describe_campaign(one, owner.name, uploads[one.id], used) for one in found]
    return CampaignList(campaigns=shown_ones, next=cursor)


def upload(
    database: Database, campaign_id: str, path: Path, media: str, sha256: str, once: Once = NOT_REPEATED
) -> Uploaded:
    """Check a file and store it whole; a file that breaks a rule leaves nothing behind.

    Raises:
        ObservationError: a rule is broken; row and column are named.
        ServiceError: no such campaign.

    """
    names = reading.column_names(path, media)
    with database.reading() as session:
        known = once.first_answer(session, sha256, UPLOADED) or _upload_by_hash(session, campaign_id, sha256, new=False)
        if known:
            return known
        _same_columns(session, campaign_id, names)
        campaign = store.get(session, campaign_id)
        robot = robots.core_robot(session, campaign.robot_id)
    chunks, warnings = checked_chunks(path, media, names, robot, campaign.conditions)
    # Parsed outside, so that this transaction is short: SQLite has one writer at a time.
    with database.transaction() as session:
        known = once.first_answer(session, sha256, UPLOADED) or _upload_by_hash(session, campaign_id, sha256, new=False)
        if known:
            return known
        _same_columns(session, campaign_id, names)
        before = None if campaign.staged else last_stamp(session, campaign_id)
        store.add_upload(session, campaign_id, sha256, media, names, chunks)
        if not campaign.staged:
            date_by_stamps(session, campaign_id, before)
        done = _upload_by_hash(session, campaign_id, sha256, new=True)
        assert done is not None
        said = [*load_campaign(session, campaign_id).warnings, *_remarks(warnings)]
        return once.keep(session, sha256, done.model_copy(update={"warnings": said}))


def check_upload(
    database: Database, robot: str, path: Path, media: str, into: NewCampaign | str | None = None, sha256: str = ""
) -> CheckedRows:
    """Check a file as an upload to a campaign of the robot would; nothing is stored.

    ``into`` is the campaign that it would make, or the id of the one it would be added to, which may have these bytes
    (``sha256``) already; without one, cameras and boards are not known, and may have any name.

    Raises:
        CoreError: what the campaign, or the upload, would be refused for; row and column are named.
        ServiceError: no such robot or campaign.

    """
    names = reading.column_names(path, media)
    with database.reading() as session:
        robot_id = robots.usable(session, robot).id
        core = robots.core_robot(session, robot_id)
        conditions = _campaign_conditions(session, robot_id, robot, into)
        if isinstance(into, str):
            known = _upload_by_hash(session, into, sha256, new=False)
            if known:
                return CheckedRows(rows=known.rows, columns=names, warnings=known.warnings)
            _same_columns(session, into, names)
    chunks, warnings = checked_chunks(path, media, names, core, conditions)
    return CheckedRows(rows=sum(chunk.rows for chunk in chunks), columns=names, warnings=_remarks(warnings))


def _campaign_conditions(
    session: Session, robot_id: int, robot: str, into: NewCampaign | str | None
) -> dict[str, Any] | None:
    """The conditions of a campaign that may be made, or may be added to; None where none is named."""
    if into is None:
        return None
    if isinstance(into, NewCampaign):
        _refuse_unfit(session, robot_id, robot, into)
        store.check_name(session, robot_id, into)
        return into.conditions.model_dump(mode="json", exclude_none=True)
    campaign = store.get(session, into)
    if campaign.robot_id != robot_id:
        raise ServiceError(
            f"Campaign {into} is not of robot {robot!r}: name one of its own.", code="campaign_not_found", campaign=into
        )
    return campaign.conditions


def checked_chunks(
    path: Path, media: str, names: Sequence[str], robot: Robot, conditions: dict[str, Any] | None = None
) -> Checked:
    """Check every row of a file of measurements and write it as chunks beside it; say what only looks odd.

    Without ``conditions``, those of the campaign, cameras and boards are not known, and may have any name.
    """
    columns = read_columns(names, [joint.kind for joint in robot.joints])
    if not any(has(columns, quantity) for quantity in MEASURED) and not all(has(columns, one) for one in WRENCH):
        raise ObservationError(
            "Nothing was measured in these rows: give x_mm, y_mm, z_mm, or markers m1x_mm ..., or link1_deg ..., or "
            "tilt1x_deg ..., or corners u1_px, v1_px ..., or what held the tool, socket_id, plane_id or bar_id with bar_mm, "
            "or joint torques tau1_nm ... with their time t_s, or readings of a force sensor at the wrist, fx_n to mz_nm."
        )
    rules = RowRules(columns, robot, views_rules(columns, conditions), conditions)
    chunks = []
    for number, table in enumerate(reading.tables(path, media, Names.from_conditions(conditions))):
        rules.check(table)
        chunks.append(write_chunk(table, path.with_name(f"chunk-{number}")))
    stated = payload_warning(robot, float((conditions or {}).get("payload_kg") or 0.0), "The payload of the campaign")
    return chunks, (*rules.finish(), *([stated] if stated else ()))


def load_campaign(session: Session, campaign_id: str) -> Campaign:
    """Return a campaign as it is shown."""
    record = store.get(session, campaign_id)
    robot, uploads = robots.by_id(session, record.robot_id).name, store.uploads_of_campaign(session, campaign_id)
    return describe_campaign(record, robot, uploads, robots.of_names(session, _instrument_names(record)))


def _instrument_names(record: CampaignRecord) -> list[str]:
    return [] if record.instrument is None else [record.instrument]


def _refuse_mixed_up(database: Database, campaign_id: str, parts: Parts) -> None:
    """Judge the parts of a staged campaign together; a single one was judged when it came."""
    if len(parts.sha256) < 2:
        return
    with database.reading() as session:
        campaign = store.get(session, campaign_id)
        there = {upload.sha256 for upload in store.uploads_of_campaign(session, campaign_id)}
        if not campaign.staged or there != set(parts.sha256):
            return
        robot = robots.core_robot(session, campaign.robot_id)
        table = store.table(session, campaign_id)
    columns = read_columns(table.column_names, [j.kind for j in robot.joints])
    refusal = judged_whole(table, columns, robot, campaign.conditions).refusal
    if refusal is not None:
        raise refusal


def _remarks(warnings: Sequence[FindingDocument]) -> list[Remark]:
    return [Remark(**one) for one in warnings]


def _upload_by_hash(session: Session, campaign_id: str, sha256: str, *, new: bool) -> Uploaded | None:
    retired.refuse_retired("campaign", campaign_id, store.get(session, campaign_id).retired_at)
    uploads = store.uploads_of_campaign(session, campaign_id)
    total = sum(upload.rows for upload in uploads)
    for upload in uploads:
        if upload.sha256 == sha256:
            return upload_result(campaign_id, upload, total, new=new)
    return None


def _same_columns(session: Session, campaign_id: str, names: Sequence[str]) -> None:
    for before in store.uploads_of_campaign(session, campaign_id):
        odd = sorted(set(names) ^ set(before.columns))
        if odd:
            raise ObservationError(
                f"Column {odd[0]!r} is not in both this upload and the campaign's earlier ones: upload to a new "
                "campaign, or give the same columns.",
                column=odd[0],
                columns=odd,
            )


def last_stamp(session: Session, campaign_id: str) -> datetime | None:
    """Return when the last row of a campaign was measured; None where its times do not count from 1970."""
    if not any(TIME in upload.columns for upload in store.uploads_of_campaign(session, campaign_id)):
        return None
    latest = pc.max(store.table(session, campaign_id).column(TIME)).as_py()
    if latest is None or latest < SINCE_1970_S:
        return None
    # Stamps without a zone are taken for UTC: those of a lab east of it may be ahead.
    return min(datetime.fromtimestamp(latest, UTC), datetime.now(UTC))


def date_by_stamps(session: Session, campaign_id: str, before: datetime | None = None) -> None:
    """Date a campaign by its last stamp, unless somebody said when it was measured; ``before`` is what stamps said so far."""
    if store.get(session, campaign_id).measured_at in (None, before):
        store.set_measured_at(session, campaign_id, last_stamp(session, campaign_id))


def refuse_other_zeros(session: Session, robot_id: int, robot: str, name: str, conditions: Mapping[str, Any]) -> None:
    """Compare the calibration of a campaign with that of the robot's campaigns in use; one that states none is left alone.

    Raises:
        ServiceError: a campaign of the robot is of another one.

    """
    stated = conditions.get(CONDITION)
    if stated is None:
        return
    for campaign_id in store.ids_of_robot(session, robot_id):
        other = store.get(session, campaign_id)
        has = other.conditions.get(CONDITION)
        if has not in (None, stated):
            raise ServiceError(
                f"Campaign {name!r} was measured with servo calibration {stated[:12]}, campaign {other.name!r} of {robot} with "
                f"{has[:12]}: with other zeros it is another arm. Add a robot for it (`kilter robot add`), or retire the "
                "campaigns of the old calibration and identify anew.",
                code="calibration_differs",
                campaign=other.id,
                stated=stated,
                has=has,
            )


def refuse_other_servos(session: Session, campaign_id: str) -> None:
    """Compare a campaign that comes into use with those that are in use.

    Raises:
        ServiceError: one of them is of another calibration.

    """
    campaign = store.get(session, campaign_id)
    robot = robots.by_id(session, campaign.robot_id).name
    refuse_other_zeros(session, campaign.robot_id, robot, campaign.name, campaign.conditions)


def describe_campaign(
    record: CampaignRecord, robot: str, uploads: Sequence[UploadRecord], instruments: Mapping[str, Instrument]
) -> Campaign:
    """Say all of a campaign of the robot of this name."""
    used = instruments.get(record.instrument or "")
    return copy_fields(
        Campaign,
        record,
        robot=robot,
        conditions=Conditions(**record.conditions),
        warnings=remarks(used, record.measured_at, record.created_at),
        rows=sum(one.rows for one in uploads),
        uploads=[copy_fields(Upload, one) for one in uploads],
    )


def upload_result(campaign_id: str, record: UploadRecord, total: int, *, new: bool) -> Uploaded:
    """Say what an upload became."""
    return copy_fields(Uploaded, record, campaign_id=campaign_id, total_rows=total, new=new)
