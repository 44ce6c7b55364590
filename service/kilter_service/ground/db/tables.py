"""The rows of Kilter's database."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import (
    JSON,
    Connection,
    ForeignKey,
    Index,
    LargeBinary,
    String,
    Text,
    UniqueConstraint,
    event,
    false,
    func,
    inspect,
    select,
    text,
)
from sqlalchemy.orm import Mapped, Mapper, mapped_column

from kilter_service.ground.db.row import MOMENT, Row, utc_now


class RobotRow(Row):
    """A robot: the document it was posted as, and the chain (SI) that this was resolved to, which is what counts.

    ``left_out`` is what of the document the chain does not have. A robot from before the chains that no longer resolves
    has none. ``versions_made`` counts purged versions too, so that no number is given twice.
    """

    __tablename__ = "robots"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(64), unique=True)
    document: Mapped[dict[str, Any]]
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    chain: Mapped[dict[str, Any] | None]
    sha256: Mapped[str] = mapped_column(String(64), default="", server_default="")
    source_sha256: Mapped[str] = mapped_column(String(64), default="", server_default="")
    left_out: Mapped[list[Any]] = mapped_column(default=list, server_default="[]")
    remarks: Mapped[str] = mapped_column(default="", server_default="")
    controller_compensation: Mapped[str] = mapped_column(String(16), default="unknown", server_default="unknown")
    tolerance_mm: Mapped[float | None]
    check_interval_days: Mapped[int | None]
    retired_at: Mapped[datetime | None]
    retired_by: Mapped[str] = mapped_column(String(64), default="", server_default="")
    versions_made: Mapped[int] = mapped_column(default=0, server_default="0")


class CampaignRow(Row):
    """One measurement campaign of a robot."""

    __tablename__ = "campaigns"
    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    robot_id: Mapped[int] = mapped_column(ForeignKey("robots.id", ondelete="RESTRICT"), index=True)
    name: Mapped[str] = mapped_column(String(200))
    device: Mapped[str] = mapped_column(String(200))
    role: Mapped[str] = mapped_column(String(16))
    conditions: Mapped[dict[str, Any]]
    notes: Mapped[str]
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    staged: Mapped[bool] = mapped_column(default=False, server_default=false())
    measured_at: Mapped[datetime | None]
    instrument: Mapped[str | None] = mapped_column(String(64))
    retired_at: Mapped[datetime | None]
    retired_by: Mapped[str] = mapped_column(String(64), default="", server_default="")


class UploadRow(Row):
    """One file of observations; the same bytes are stored once per campaign."""

    __tablename__ = "uploads"
    __table_args__ = (UniqueConstraint("campaign_id", "sha256"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    campaign_id: Mapped[str] = mapped_column(ForeignKey("campaigns.id", ondelete="RESTRICT"), index=True)
    sha256: Mapped[str] = mapped_column(String(64))
    rows: Mapped[int]
    columns: Mapped[list[Any]]
    media_type: Mapped[str] = mapped_column(String(64))
    created_at: Mapped[datetime] = mapped_column(default=utc_now)


class ChunkRow(Row):
    """Some rows of an upload as a compressed Parquet file."""

    __tablename__ = "chunks"
    upload_id: Mapped[int] = mapped_column(ForeignKey("uploads.id", ondelete="CASCADE"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True)
    rows: Mapped[int]
    sha256: Mapped[str] = mapped_column(String(64))
    parquet: Mapped[bytes] = mapped_column(LargeBinary)


# Written out in queries as in the index: a database takes it only where it sees the same condition. However many jobs are
# over, those that workers look for are few.
NOT_OVER = text("state IN ('queued', 'running')")


class JobRow(Row):
    """A job: its request, its state, and how it ended. ``worker`` is the id of the process that runs it, or ran it last.

    ``asked_by`` is who sent the request, for the audit of what the job stores; empty in jobs of earlier releases.
    """

    __tablename__ = "jobs"
    __table_args__ = (
        Index("ix_jobs_newest", "created_at", "id"),
        Index("ix_jobs_newest_of_robot", "robot_id", "created_at", "id"),
        Index("ix_jobs_not_over", "created_at", "id", sqlite_where=NOT_OVER, postgresql_where=NOT_OVER),
    )
    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    kind: Mapped[str] = mapped_column(String(32))
    robot_id: Mapped[int] = mapped_column(ForeignKey("robots.id", ondelete="CASCADE"))
    request: Mapped[dict[str, Any]]
    state: Mapped[str] = mapped_column(String(16), index=True)
    fraction: Mapped[float] = mapped_column(default=0.0)
    stage: Mapped[str] = mapped_column(String(200), default="queued")
    attempts: Mapped[int] = mapped_column(default=0)
    cancel_requested: Mapped[bool] = mapped_column(default=False)
    error: Mapped[dict[str, Any] | None]
    result: Mapped[dict[str, Any] | None]
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    started_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]
    name: Mapped[str] = mapped_column(String(200), default="", server_default="")
    request_id: Mapped[str] = mapped_column(String(64), default="", server_default="")
    traceparent: Mapped[str] = mapped_column(String(64), default="", server_default="")
    worker: Mapped[str] = mapped_column(String(200), default="", server_default="")
    asked_by: Mapped[dict[str, Any]] = mapped_column(JSON, default=dict, server_default="{}")


class EndedJobsRow(Row):
    """How many jobs of a kind and an end took at most so long, and longer than the row below; 0: they never ran.

    Jobs may be purged; what was counted stays.
    """

    __tablename__ = "ended_jobs"
    kind: Mapped[str] = mapped_column(String(32), primary_key=True)
    state: Mapped[str] = mapped_column(String(16), primary_key=True)
    at_most_ms: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    jobs: Mapped[int]
    seconds: Mapped[float]


class VersionRow(Row):
    """A set of identified parameters; what it says is never changed after it is stored, what people call it may be.

    ``sha256`` covers calibration and limits (``hash_scheme`` 1), and the robot's chain too (2). ``number`` counts the
    versions of its robot from 1.
    """

    __tablename__ = "versions"
    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    robot_id: Mapped[int] = mapped_column(ForeignKey("robots.id", ondelete="RESTRICT"), index=True)
    parent_id: Mapped[str | None] = mapped_column(ForeignKey("versions.id", ondelete="RESTRICT"))
    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id", ondelete="RESTRICT"), unique=True)
    sha256: Mapped[str] = mapped_column(String(64))
    calibration: Mapped[dict[str, Any]]
    report: Mapped[dict[str, Any]]
    covariance: Mapped[dict[str, Any]]
    campaigns: Mapped[list[Any]]
    limits: Mapped[dict[str, Any]]
    code_version: Mapped[str] = mapped_column(String(64))
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    hash_scheme: Mapped[int] = mapped_column(default=1, server_default="1")
    robot_sha256: Mapped[str] = mapped_column(String(64), default="", server_default="")
    name: Mapped[str] = mapped_column(String(200), default="", server_default="")
    notes: Mapped[str] = mapped_column(default="", server_default="")
    retired_at: Mapped[datetime | None]
    retired_by: Mapped[str] = mapped_column(String(64), default="", server_default="")
    number: Mapped[int] = mapped_column(default=0, server_default="0")


class ActivationRow(Row):
    """An entry of the log of which version was made active, when and by whom; the last one of a robot holds.

    ``objections`` are what spoke against it; ``forced`` says that it was made active in spite of them.
    """

    __tablename__ = "activations"
    id: Mapped[int] = mapped_column(primary_key=True)
    robot_id: Mapped[int] = mapped_column(ForeignKey("robots.id", ondelete="RESTRICT"), index=True)
    version_id: Mapped[str] = mapped_column(ForeignKey("versions.id", ondelete="RESTRICT"))
    action: Mapped[str] = mapped_column(String(16))
    actor: Mapped[str] = mapped_column(String(64))
    at: Mapped[datetime] = mapped_column(default=utc_now)
    forced: Mapped[bool] = mapped_column(default=False, server_default=false())
    reason: Mapped[str] = mapped_column(String(500), default="", server_default="")
    objections: Mapped[list[Any]] = mapped_column(default=list, server_default="[]")


class ReplayRow(Row):
    """Task and rules that a version was activated under, and its answers at some setpoints, which an upgrade replays.

    ``setpoints`` and ``answers`` are joints (N, n), rad or m, as little-endian float64; NaN where a setpoint is refused.
    """

    __tablename__ = "replays"
    activation_id: Mapped[int] = mapped_column(ForeignKey("activations.id", ondelete="RESTRICT"), primary_key=True)
    rules: Mapped[dict[str, Any]]
    setpoints: Mapped[bytes] = mapped_column(LargeBinary)
    answers: Mapped[bytes] = mapped_column(LargeBinary)
    made_by: Mapped[str] = mapped_column(String(16))
    code_version: Mapped[str] = mapped_column(String(64))


class HeartbeatRow(Row):
    """A process that says it is alive."""

    __tablename__ = "heartbeats"
    process: Mapped[str] = mapped_column(String(64), primary_key=True)
    name: Mapped[str] = mapped_column(String(200), primary_key=True)
    pid: Mapped[int]
    at: Mapped[datetime]
    details: Mapped[dict[str, Any]] = mapped_column(JSON, default=dict, server_default="{}")


class TombstoneRow(Row):
    """What is left of something that was purged. A name may be purged, used again and purged again."""

    __tablename__ = "tombstones"
    kind: Mapped[str] = mapped_column(String(16), primary_key=True)
    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    at: Mapped[datetime] = mapped_column(primary_key=True)
    robot: Mapped[str] = mapped_column(String(64))
    name: Mapped[str] = mapped_column(String(200))
    sha256: Mapped[str] = mapped_column(String(64))
    by: Mapped[str] = mapped_column(String(64))


class TokenRow(Row):
    """A token: the hash of its secret, what it may do, with which robots (None: all), and until when."""

    __tablename__ = "tokens"
    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    name: Mapped[str] = mapped_column(String(64), index=True)
    sha256: Mapped[str] = mapped_column(String(64), unique=True)
    role: Mapped[str] = mapped_column(String(16))
    robots: Mapped[list[Any] | None] = mapped_column(JSON(none_as_null=True))
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    created_by: Mapped[str] = mapped_column(String(64))
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]
    revoked_by: Mapped[str] = mapped_column(String(64), default="", server_default="")


class AuditRow(Row):
    """An entry of the audit: what was changed, as the text that its hash covers together with the hash before it.

    The database itself refuses to change or delete one, and to add one that does not continue the chain.
    """

    __tablename__ = "audit"
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    previous: Mapped[str] = mapped_column(String(64))
    sha256: Mapped[str] = mapped_column(String(64))
    content: Mapped[str] = mapped_column(Text)


class LoginRow(Row):
    """Somebody is logged in at the page: the hash of what the browser keeps, and of the token that was given."""

    __tablename__ = "logins"
    sha256: Mapped[str] = mapped_column(String(64), primary_key=True)
    token_sha256: Mapped[str] = mapped_column(String(64), index=True)
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    expires_at: Mapped[datetime] = mapped_column(index=True)


class AnsweredRow(Row):
    """The first answer of a request that may be sent again; the id is of key, address and token."""

    __tablename__ = "answered"
    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    body_sha256: Mapped[str] = mapped_column(String(64))
    answer: Mapped[dict[str, Any]] = mapped_column(JSON)
    at: Mapped[datetime] = mapped_column(default=utc_now, index=True)


class FleetJobRow(Row):
    """A request to identify many robots anew; its robots have rows and jobs of their own, which say how far it is."""

    __tablename__ = "fleet_jobs"
    __table_args__ = (Index("ix_fleet_jobs_newest", "created_at", "id"),)
    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    name: Mapped[str] = mapped_column(String(200), default="", server_default="")
    request: Mapped[dict[str, Any]]
    created_at: Mapped[datetime] = mapped_column(default=utc_now)
    cancelled_at: Mapped[datetime | None]


class FleetRobotRow(Row):
    """A robot of a fleet job: its job, or the refusal of one.

    ``before_id`` is the version that was active when the fleet job was asked for, ``judged`` how the new one compares
    with it.
    """

    __tablename__ = "fleet_robots"
    fleet_id: Mapped[str] = mapped_column(ForeignKey("fleet_jobs.id", ondelete="CASCADE"), primary_key=True)
    robot_id: Mapped[int] = mapped_column(ForeignKey("robots.id", ondelete="CASCADE"), primary_key=True, index=True)
    job_id: Mapped[str | None] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), unique=True)
    before_id: Mapped[str | None] = mapped_column(String(32))
    refusal: Mapped[dict[str, Any] | None]
    judged: Mapped[dict[str, Any] | None]


class MeshRow(Row):
    """The shape of a robot's link: an STL or OBJ file, for the picture of the arm."""

    __tablename__ = "meshes"
    robot_id: Mapped[int] = mapped_column(ForeignKey("robots.id", ondelete="CASCADE"), primary_key=True)
    link: Mapped[str] = mapped_column(String(64), primary_key=True)
    format: Mapped[str] = mapped_column(String(8))
    unit: Mapped[str] = mapped_column(String(8))
    triangles: Mapped[int]
    sha256: Mapped[str] = mapped_column(String(64))
    content: Mapped[bytes] = mapped_column(LargeBinary)
    created_at: Mapped[datetime] = mapped_column(default=utc_now)


class InstrumentRow(Row):
    """An instrument as one certificate describes it: its permissible error for a length, and until when that holds.

    It is never changed or deleted: what was measured with it rests on it. Days are ISO 8601.
    """

    __tablename__ = "instruments"
    name: Mapped[str] = mapped_column(String(64), primary_key=True)
    kind: Mapped[str] = mapped_column(String(32))
    serial_number: Mapped[str] = mapped_column(String(200))
    mpe_standard: Mapped[str] = mapped_column(String(32))
    mpe_um: Mapped[float]
    mpe_um_per_m: Mapped[float]
    certificate: Mapped[str] = mapped_column(String(200))
    certified_on: Mapped[str | None] = mapped_column(String(10))
    valid_until: Mapped[str | None] = mapped_column(String(10))
    notes: Mapped[str]
    created_at: Mapped[datetime] = mapped_column(default=utc_now)


class RepairRow(Row):
    """What was done to an arm, and when: what was measured before is of the arm as it was. A ``note`` changes nothing."""

    __tablename__ = "repairs"
    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    robot_id: Mapped[int] = mapped_column(ForeignKey("robots.id", ondelete="CASCADE"), index=True)
    at: Mapped[datetime]
    what: Mapped[str] = mapped_column(String(200))
    actor: Mapped[str] = mapped_column(String(64))
    kind: Mapped[str] = mapped_column(String(8), default="repair", server_default="repair")
    campaign_id: Mapped[str | None] = mapped_column(String(32))
    rows: Mapped[str] = mapped_column(String(200), default="", server_default="")
    created_at: Mapped[datetime] = mapped_column(default=utc_now)


class CreepingRow(Row):
    """A robot that the operator's address was told to be creeping, and by which check: it is told the end, too."""

    __tablename__ = "creeping"
    robot_id: Mapped[int] = mapped_column(ForeignKey("robots.id", ondelete="CASCADE"), primary_key=True)
    job_id: Mapped[str] = mapped_column(String(32))
    told_at: Mapped[datetime] = mapped_column(default=utc_now)


def _assign_creation_time(_mapper: Mapper[Any], connection: Connection, row: Any) -> None:
    """Date a row after the others (of its robot): the clock may have been set back, and `latest` is the newest."""
    if row.created_at is None:
        others = type(row).__table__.c
        query = select(func.max(others.created_at))
        if "robot_id" in others:
            query = query.where(others.robot_id == row.robot_id)
        newest = connection.execute(query).scalar()
        row.created_at = utc_now() if newest is None else max(utc_now(), newest + MOMENT)


for _dated in (CampaignRow, FleetJobRow, JobRow, TokenRow, VersionRow):
    event.listen(_dated, "before_insert", _assign_creation_time)

OF_PEOPLE = frozenset({"name", "notes", "retired_at", "retired_by"})  # what may change of a version


def _refuse_change(_mapper: Mapper[Any], _connection: Any, row: Row) -> None:
    changed = {attribute.key for attribute in inspect(row).attrs if attribute.history.has_changes()}
    if isinstance(row, VersionRow) and changed <= OF_PEOPLE:
        return
    raise RuntimeError(f"{type(row).__name__} is immutable: store a new one instead of changing it.")


for _immutable in (VersionRow, ActivationRow, ReplayRow, ChunkRow, AuditRow):
    event.listen(_immutable, "before_update", _refuse_change)
