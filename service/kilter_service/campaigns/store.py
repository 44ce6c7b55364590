"""Rows of campaigns, uploads and chunks, and what they become in core.

What the jobs that made versions said of rows.
"""

from __future__ import annotations

import hashlib
import io
import json
import uuid
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from sqlalchemy import and_, delete, func, or_, select

from kilter_core.errors import ObservationError
from kilter_core.observations import with_directions
from kilter_files.ground import NAMED_SESSIONS
from kilter_files.ground.later import pa, parquet
from kilter_service.contract.campaigns import NewCampaign
from kilter_service.contract.columns import CONTACTS
from kilter_service.contract.devices import Instrument
from kilter_service.contract.jobs.kind import FINAL
from kilter_service.contract.wording import Remark
from kilter_service.ground import store as references
from kilter_service.ground.db import Session
from kilter_service.ground.db.tables import CampaignRow, ChunkRow, JobRow, UploadRow, VersionRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import copy_fields
from kilter_service.ground.paging import Page
from kilter_service.ground.tables.assemble import observations as assemble
from kilter_service.ground.tables.assemble import with_default_load
from kilter_service.ground.tables.columns import read_columns
from kilter_service.robots import store as robots
from kilter_service.robots.store import remarks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from kilter_core.arm import Robot
    from kilter_core.observations import Observations


MOST_NAMED = 500  # ids in one query
FEWEST_HELD = 4  # rows of each socket, plane and bar that stay where only some are read: its place is found from them


def check_name(session: Session, robot_id: int, campaign: NewCampaign) -> None:
    """Refuse the name of a campaign that is to be stored.

    Raises:
        ServiceError: another campaign of the robot has it, and no number may be put behind it, or it looks like an id.

    """
    if campaign.numbered:
        references.check_form("campaign", campaign.name)
    else:
        references.check_name(session, "campaign", robot_id, campaign.name)


def add(session: Session, robot_id: int, campaign: NewCampaign) -> str:
    """Store a new campaign and return its id.

    Raises:
        ServiceError: its name, as for `check_name`.

    """
    check_name(session, robot_id, campaign)
    name = campaign.name
    if campaign.numbered:
        name = references.free_name(session, "campaign", robot_id, name)
    row = CampaignRow(
        id=f"cmp_{uuid.uuid4().hex[:16]}",
        robot_id=robot_id,
        name=name,
        device=campaign.device,
        role=campaign.role,
        conditions=campaign.conditions.model_dump(mode="json", exclude_none=True),
        notes=campaign.notes,
        staged=campaign.staged,
        measured_at=campaign.measured_at,
        instrument=campaign.instrument,
    )
    session.add(row)
    return row.id


def get(session: Session, campaign_id: str) -> CampaignRecord:
    """Return a campaign.

    Raises:
        ServiceError: there is none.

    """
    return _record(_row(session, campaign_id))


def _record(row: CampaignRow) -> CampaignRecord:
    return copy_fields(CampaignRecord, row)


def _row(session: Session, campaign_id: str) -> CampaignRow:
    return robots.visible_row(session, CampaignRow, campaign_id, "GET /v1/robots/{robot}/campaigns")


def whole(session: Session, campaign_id: str) -> CampaignRecord:
    """Return a campaign whose parts are all there.

    Raises:
        ServiceError: there is none, or parts of it are missing.

    """
    found = get(session, campaign_id)
    if found.staged:
        raise ServiceError(
            f"Campaign {campaign_id} is not whole: give the command that sends it again, and it goes on.",
            code="campaign_incomplete",
            campaign=campaign_id,
        )
    return found


def usable(session: Session, campaign_id: str) -> CampaignRecord:
    """Return a campaign that is whole and in use.

    Raises:
        ServiceError: there is none, parts of it are missing, or it is retired.

    """
    found = whole(session, campaign_id)
    references.refuse_retired("campaign", found.id, found.retired_at)
    return found


def instruments(session: Session, campaign_ids: Collection[str]) -> dict[str, Instrument]:
    """Return the instruments of the campaigns that name one, by id of the campaign."""
    named = {key: get(session, key).instrument for key in campaign_ids}
    known = robots.of_names(session, {name for name in named.values() if name is not None})
    return {key: known[name] for key, name in named.items() if name in known}


def certificates(session: Session, campaign_ids: Collection[str]) -> dict[str, list[Remark]]:
    """Return what the certificates of their instruments have against campaigns, by id; those that hold are left out."""
    records = {key: get(session, key) for key in dict.fromkeys(campaign_ids)}
    named = instruments(session, records)
    found = {key: remarks(named.get(key), one.measured_at, one.created_at) for key, one in records.items()}
    return {key: said for key, said in found.items() if said}


def commit(session: Session, campaign_id: str) -> None:
    """Make a staged campaign one that is listed and used; a name that was taken meanwhile gets a number."""
    row = _row(session, campaign_id)
    if row.staged:
        row.name = references.free_name(session, "campaign", row.robot_id, row.name)
        row.staged = False


def delete_whole(session: Session, campaign_id: str) -> None:
    """Delete a campaign with all that was uploaded to it."""
    session.execute(delete(UploadRow).where(UploadRow.campaign_id == campaign_id))
    session.execute(delete(CampaignRow).where(CampaignRow.id == campaign_id))


def unfinished_jobs(session: Session, campaign_id: str) -> list[str]:
    """Return the ids of jobs that are not over and use a campaign."""
    robot_id = _row(session, campaign_id).robot_id
    rows = session.execute(select(JobRow).where(JobRow.robot_id == robot_id, JobRow.state.not_in(FINAL))).scalars()
    return [row.id for row in rows if campaign_id in json.dumps(row.request)]


def discard(session: Session, campaign_id: str) -> None:
    """Delete a staged campaign with all that was sent to it."""
    session.execute(delete(UploadRow).where(UploadRow.campaign_id == campaign_id))
    session.execute(delete(CampaignRow).where(CampaignRow.id == campaign_id, CampaignRow.staged))


def staged_before(session: Session, robot_id: int, moment: datetime) -> list[str]:
    """Return the ids of a robot's staged campaigns that were begun before a moment."""
    query = select(CampaignRow.id).where(CampaignRow.robot_id == robot_id, CampaignRow.staged)
    return list(session.execute(query.where(CampaignRow.created_at < moment)).scalars())


def campaigns_on_page(
    session: Session, robot_id: int, staged: bool, page: Page, with_retired: bool = False
) -> list[CampaignRecord]:
    """Return campaigns of a robot, oldest first, one more than the page shows; those out of use only when asked for."""
    row = CampaignRow
    query = select(row).where(row.robot_id == robot_id, row.staged == staged).order_by(row.created_at, row.id)
    if not with_retired:
        query = query.where(row.retired_at.is_(None))
    if page.moment is not None:
        moment, key = page.moment
        query = query.where(or_(row.created_at > moment, and_(row.created_at == moment, row.id > key)))
    return [_record(found) for found in session.execute(query.limit(page.fetch_limit)).scalars()]


def ids_of_robot(session: Session, robot_id: int) -> list[str]:
    """Return the ids of a robot's campaigns that are whole and in use, oldest first."""
    row = CampaignRow
    query = select(row.id).where(row.robot_id == robot_id, row.staged.is_(False), row.retired_at.is_(None))
    return list(session.execute(query.order_by(row.created_at, row.id)).scalars())


def ids_before(session: Session, robot_id: int, campaign_id: str) -> list[str]:
    """Return the campaigns of a robot in use that were measured before one; where nobody stated when, sent before it."""
    row, one = CampaignRow, session.get(CampaignRow, campaign_id)
    if one is None:
        return []
    query = select(row.id, row.measured_at, row.created_at).where(row.robot_id == robot_id, row.retired_at.is_(None))
    return [
        key
        for key, stated, sent in session.execute(query)
        if (sent < one.created_at if stated is None or one.measured_at is None else stated < one.measured_at)
    ]


def ids_until(session: Session, robot_id: int, moment: datetime) -> list[str]:
    """Return the campaigns of a robot in use that were measured before a moment; where nobody stated when, sent before it."""
    row = CampaignRow
    at = func.coalesce(row.measured_at, row.created_at)
    return list(session.execute(select(row.id).where(row.robot_id == robot_id, at < moment)).scalars())


def uploads_of_campaign(session: Session, campaign_id: str) -> list[UploadRecord]:
    """Return the uploads of a campaign, oldest first."""
    return uploads_of_all(session, [campaign_id])[campaign_id]


def uploads_of_all(session: Session, campaign_ids: Sequence[str]) -> dict[str, list[UploadRecord]]:
    """Return the uploads of campaigns, oldest first, by one query for many of them."""
    found: dict[str, list[UploadRecord]] = {one: [] for one in campaign_ids}
    for first in range(0, len(campaign_ids), MOST_NAMED):
        some = campaign_ids[first : first + MOST_NAMED]
        query = select(UploadRow).where(UploadRow.campaign_id.in_(some)).order_by(UploadRow.id)
        for row in session.execute(query).scalars():
            found[row.campaign_id].append(copy_fields(UploadRecord, row))
    return found


def add_upload(
    session: Session, campaign_id: str, sha256: str, media: str, columns: Sequence[str], chunks: Sequence[Chunk]
) -> None:
    """Store an upload and its chunks."""
    rows = sum(chunk.rows for chunk in chunks)
    upload = UploadRow(campaign_id=campaign_id, sha256=sha256, rows=rows, columns=list(columns), media_type=media)
    session.add(upload)
    session.flush()
    for number, chunk in enumerate(chunks):
        blob = chunk.path.read_bytes()
        session.add(ChunkRow(upload_id=upload.id, number=number, rows=chunk.rows, sha256=chunk.sha256, parquet=blob))
        session.flush()


def set_measured_at(session: Session, campaign_id: str, at: datetime | None) -> None:
    """Store when the last row of a campaign was measured."""
    session.get_one(CampaignRow, campaign_id).measured_at = at
    session.flush()


def device(session: Session, campaign_id: str) -> str:
    """Return what a campaign was measured with."""
    return whole(session, campaign_id).device


def observations(
    session: Session, campaign_id: str, robot: Robot, only: Collection[str] | None = None, every: int = 1
) -> Observations:
    """Return all rows of a campaign, SI, in the order of its uploads; or those of the uploads with these hashes.

    Of the rows of each stored part one in ``every`` is taken, and a few of every socket, plane and bar.

    Raises:
        ObservationError: nothing was uploaded yet.

    """
    row = whole(session, campaign_id)
    query = select(UploadRow).where(UploadRow.campaign_id == campaign_id).order_by(UploadRow.id)
    uploads = [u for u in session.execute(query).scalars() if only is None or u.sha256 in only]
    if not uploads:
        raise ObservationError(f"Campaign {campaign_id} has no observations: upload some.", campaign=campaign_id)
    columns = read_columns(uploads[0].columns, [joint.kind for joint in robot.joints])
    tables = [
        _thin_rows(table.select(uploads[0].columns), every)
        for upload in uploads
        for table in _tables(session, upload.id)
    ]
    return with_directions(with_default_load(assemble(pa.concat_tables(tables), columns, row.conditions), robot))


def table(session: Session, campaign_id: str) -> pa.Table:
    """Return all rows of a campaign as they were uploaded, in the order of its uploads.

    Raises:
        ObservationError: nothing was uploaded yet.

    """
    query = select(UploadRow).where(UploadRow.campaign_id == campaign_id).order_by(UploadRow.id)
    uploads = list(session.execute(query).scalars())
    if not uploads:
        raise ObservationError(f"Campaign {campaign_id} has no observations: upload some.", campaign=campaign_id)
    return pa.concat_tables(
        [part.select(uploads[0].columns) for upload in uploads for part in _tables(session, upload.id)]
    )


def states_a_load(session: Session, campaign_id: str) -> bool:
    """Whether a campaign says what hung on the tool, in its conditions or in its columns."""
    if whole(session, campaign_id).conditions.get("payload_kg") is not None:
        return True
    return any("payload_kg" in upload.columns for upload in uploads_of_campaign(session, campaign_id))


def _thin_rows(table: pa.Table, every: int) -> pa.Table:
    if every == 1:
        return table
    some = [np.arange(0, len(table), every)]
    for name in CONTACTS:
        if name in table.column_names:
            held_by = table.column(name).to_numpy(zero_copy_only=False)
            some += [np.flatnonzero(held_by == number)[:FEWEST_HELD] for number in np.unique(held_by[held_by > 0])]
    return table.take(np.unique(np.concatenate(some)))


def driven(session: Session, robot_id: int, robot: Robot, most: int = 20_000) -> NDArray[np.float64] | None:
    """Return joint readings (N, n) of all a robot's campaigns, thinned to about ``most``; None without any."""
    parts = []
    for campaign in ids_of_robot(session, robot_id):
        try:
            parts.append(observations(session, campaign, robot).q)
        except ObservationError:
            continue  # nothing was uploaded to it yet
    whole = np.concatenate(parts) if parts else np.zeros((0, robot.n_joints))
    return whole[:: -(-len(whole) // most)] if len(whole) else None


def renumber_poses_and_sessions(parts: Iterable[Observations]) -> list[Observations]:
    """Give the poses and sessions of several campaigns numbers of their own: pose 1 of one is not pose 1 of another.

    Sessions that have names are the same in all of them.
    """
    out, poses = [], 0
    sessions: dict[tuple[int, int], int] = {}
    for place, part in enumerate(parts):
        changes: dict[str, Any] = {}
        if part.pose_id is not None:
            ids = np.unique(part.pose_id, return_inverse=True)[1].astype(np.int64)
            changes["pose_id"] = ids + poses
            poses += int(ids.max()) + 1
        if part.session is not None:
            codes, first, ids = np.unique(part.session, return_index=True, return_inverse=True)
            own = np.zeros(len(codes), dtype=np.int64)
            for k in np.lexsort((codes, np.where(codes < NAMED_SESSIONS, -1, first))):  # names in the order of the rows
                key = (-1 if codes[k] >= NAMED_SESSIONS else place, int(codes[k]))
                own[k] = sessions.setdefault(key, len(sessions))
            changes["session"] = own[ids.reshape(-1)]
        out.append(replace(part, **changes))
    return out


def _tables(session: Session, upload_id: int) -> list[pa.Table]:
    query = select(ChunkRow.parquet, ChunkRow.sha256).where(ChunkRow.upload_id == upload_id).order_by(ChunkRow.number)
    return [read_chunk(blob, sha256) for blob, sha256 in session.execute(query)]


@dataclass(frozen=True)
class UploadRecord:
    """A stored file of observations."""

    sha256: str
    rows: int
    columns: list[str]
    media_type: str
    created_at: datetime


@dataclass(frozen=True)
class CampaignRecord:
    """A stored campaign, without its uploads."""

    id: str
    robot_id: int
    name: str
    device: str
    role: str
    conditions: dict[str, Any]
    notes: str
    staged: bool
    measured_at: datetime | None
    instrument: str | None
    created_at: datetime
    retired_at: datetime | None


@dataclass(frozen=True)
class Chunk:
    """A Parquet file beside the upload, its rows and its hash; its bytes are read when it is stored."""

    path: Path
    rows: int
    sha256: str


def write_chunk(table: pa.Table, path: Path) -> Chunk:
    """Write rows as Parquet (zstd)."""
    parquet.write_table(table, path, compression="zstd")
    return Chunk(path, table.num_rows, hashlib.sha256(path.read_bytes()).hexdigest())


def read_chunk(blob: bytes, sha256: str) -> pa.Table:
    """Read the rows of a stored chunk.

    Raises:
        ServiceError: the bytes are no longer those that were stored.

    """
    if hashlib.sha256(blob).hexdigest() != sha256:
        raise ServiceError(
            f"Stored observations are damaged (chunk {sha256[:12]}): restore the database from a backup."
        )
    return parquet.ParquetFile(io.BytesIO(blob)).read(use_threads=False)  # read_table imports datasets, 8 MB


@dataclass(frozen=True)
class Said:
    """A version that set rows aside: the kind of its job, and what it stored of each row."""

    version_id: str
    name: str
    job_id: str
    kind: str
    rows: list[dict[str, Any]]


def iter_set_aside_rows(session: Session, campaign_id: str) -> Iterator[Said]:
    """Yield what the versions of a campaign's robot say of rows of the campaign, oldest first."""
    version, aside = VersionRow, VersionRow.report["set_aside"]
    query = (
        select(version.id, version.name, version.job_id, JobRow.kind, version.campaigns, aside)
        .join(JobRow, JobRow.id == version.job_id)
        .join(CampaignRow, CampaignRow.robot_id == version.robot_id)
        .where(CampaignRow.id == campaign_id)
        .order_by(version.created_at, version.id)
    )
    for key, name, job, kind, used, rows in session.execute(query):
        if any(one["id"] == campaign_id for one in used):
            mine = [row for row in rows or [] if row.get("campaign") in (campaign_id, None)]
            if mine:
                yield Said(key, name, job, kind, mine)
