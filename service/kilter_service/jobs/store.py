"""Rows of jobs."""

from __future__ import annotations

import uuid
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from sqlalchemy import ColumnElement, Select, case, func, or_, select

from kilter_service.campaigns import store as campaigns
from kilter_service.contract.jobs.check import NEWEST
from kilter_service.contract.jobs.kind import FINAL
from kilter_service.contract.jobs.registry import NewJob
from kilter_service.contract.versions import CorrectionLimits, Objection
from kilter_service.ground import store as ended
from kilter_service.ground.caller import allowed_robots, as_document
from kilter_service.ground.core import core_motion
from kilter_service.ground.db import Session
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import NOT_OVER, JobRow, RobotRow, VersionRow
from kilter_service.ground.naming import copy_fields, job_noun
from kilter_service.ground.paging import Page
from kilter_service.ground.settings import code_version
from kilter_service.jobs.durations import PastRun
from kilter_service.jobs.kind import FitOfVersion, JobInput, JobKind, VersionContent
from kilter_service.jobs.plotly_figures.layout import add_captions
from kilter_service.jobs.records import (
    Asked,
    JobRecord,
    JobRequest,
    ListedJob,
    Place,
    ProgressRecord,
    UsedRecord,
    WantedJobs,
    load_version_fit,
)
from kilter_service.jobs.refusals import read_options
from kilter_service.jobs.registry import get_job_kind
from kilter_service.robots import store as robots
from kilter_service.versions import store as versions
from kilter_service.versions.records import VersionRecord
from kilter_service.versions.store import TORQUES, NewVersion

if TYPE_CHECKING:
    from kilter_core.observations import Observations

NOBODY = Asked()
MOTION, TORQUES_FROM = "motion", "torques_from"  # of a report: what a log of torques said, and the search's name
OF_TORQUES = {TORQUES, MOTION, TORQUES_FROM}
MOST_PAST = 20  # earlier jobs that tell how long one takes
MOST_PLACES = 1000  # jobs that are not over whose place is told


def add(session: Session, robot_id: int, job: NewJob, asked: Asked = NOBODY) -> str:
    """Store a queued job and return its id."""
    row = JobRow(
        id=f"job_{uuid.uuid4().hex[:16]}",
        kind=job.kind,
        robot_id=robot_id,
        name=job.name or _next_name(session, robot_id, job),
        request=job.model_dump(mode="json"),
        state="queued",
        request_id=asked.request_id,
        traceparent=asked.traceparent,
        asked_by=as_document(),
    )
    session.add(row)
    session.flush()
    return row.id


def _next_name(session: Session, robot_id: int, job: NewJob) -> str:
    """Return the name of a job that nobody gave one: "gap search of tour 3"."""
    start = f"{job_noun(job.kind)} of {job.robot} "
    query = select(JobRow.name).where(JobRow.robot_id == robot_id, JobRow.name.startswith(start, autoescape=True))
    numbers = [name.removeprefix(start) for name in session.execute(query).scalars()]
    return f"{start}{max((int(number) for number in numbers if number.isdecimal()), default=0) + 1}"


def _row(session: Session, job_id: str) -> JobRow:
    return robots.visible_row(session, JobRow, job_id, "GET /v1/jobs")


def get(session: Session, job_id: str) -> JobRecord:
    """Return a job.

    Raises:
        ServiceError: there is none.

    """
    return _record(session, _row(session, job_id))


def progress(session: Session, job_ids: Sequence[str]) -> list[ProgressRecord]:
    """Return how far jobs are, with one query."""
    row = JobRow
    found = session.execute(select(row.id, row.state, row.fraction, row.stage).where(row.id.in_(job_ids)))
    return [ProgressRecord(*one) for one in found]


def places(session: Session) -> dict[str, Place]:
    """Return where the oldest jobs stand that are not over, by their ids, in the order in which workers take them."""
    row = JobRow
    query = select(row.id, row.kind, row.state, row.worker).where(NOT_OVER).order_by(row.created_at, row.id)
    waiting: Counter[str] = Counter()
    found = {}
    for job, kind, state, worker in session.execute(query.limit(MOST_PLACES)):
        queue = get_job_kind(kind).queue
        found[job] = Place(0, worker) if state == "running" else Place(waiting[queue], "")
        waiting[queue] += state == "queued"
    return found


def newest_jobs(session: Session, robot: str | None, page: Page) -> list[ListedJob]:
    """Return the newest jobs, of one robot or of all, one more than the page shows; results are large and stay unread."""
    row = JobRow
    query = select(*_job_list_columns()).order_by(row.created_at.desc(), row.id)
    if allowed_robots() is not None:
        query = robots.visible(query.join(RobotRow, RobotRow.id == row.robot_id))
    if robot is not None:
        query = query.where(row.robot_id == robots.get(session, robot).id)
    if page.moment is not None:
        moment, key = page.moment  # said so that the range of an index is read, not all of it
        query = query.where(row.created_at <= moment, or_(row.created_at < moment, row.id > key))
    return _jobs(session, query.limit(page.fetch_limit))


def _job_list_columns() -> tuple[Any, ...]:
    row = JobRow
    return (
        row.id,
        row.kind,
        row.robot_id,
        row.name,
        row.state,
        row.fraction,
        row.stage,
        row.error,
        func.coalesce(row.asked_by["actor"].as_string(), ""),
        row.created_at,
        row.started_at,
        row.finished_at,
    )


def _jobs(session: Session, query: Select[Any]) -> list[ListedJob]:
    found = session.execute(query).all()
    names = robots.names(session, {one.robot_id for one in found})
    return [ListedJob(job, kind, names[robot_id], *rest) for job, kind, robot_id, *rest in found]


def count_jobs(session: Session, wanted: WantedJobs) -> tuple[int, int]:
    """Return how many jobs are as wanted, and how many there are of the robot, or of all."""
    of_robot = WantedJobs(wanted.robot)
    counts = [
        session.execute(_filter_wanted_jobs(session, select(func.count()), one)).scalar_one()
        for one in (wanted, of_robot)
    ]
    return counts[0], counts[1]


def wanted_jobs(session: Session, wanted: WantedJobs, offset: int, limit: int) -> list[ListedJob]:
    """Return ``limit`` of the jobs that are wanted, in the order that is; equal ones newest first."""
    row = JobRow
    by = {
        "name": func.lower(func.coalesce(func.nullif(row.name, ""), row.id)),
        "robot": func.lower(RobotRow.name),
        "kind": case({kind: k for k, kind in enumerate(wanted.kinds)}, value=row.kind, else_=len(wanted.kinds)),
        "state": case({state: k for k, state in enumerate(wanted.states)}, value=row.state, else_=len(wanted.states)),
        "asked": row.created_at,
    }[wanted.order]
    query = _filter_wanted_jobs(session, select(*_job_list_columns()), wanted)
    query = query.order_by(by.desc() if wanted.falling else by, row.created_at.desc(), row.id)
    return _jobs(session, query.offset(offset).limit(limit))


def _filter_wanted_jobs(session: Session, query: Select[Any], wanted: WantedJobs) -> Select[Any]:
    row = JobRow
    query = robots.visible(query.select_from(JobRow).join(RobotRow, RobotRow.id == row.robot_id))
    if wanted.robot is not None:
        query = query.where(row.robot_id == robots.get(session, wanted.robot).id)
    if wanted.kind is not None:
        query = query.where(row.kind == wanted.kind)
    if wanted.state is not None:
        query = query.where(row.state == wanted.state)
    places = (row.name, RobotRow.name, func.coalesce(row.asked_by["actor"].as_string(), ""), row.id)
    for word, kinds in wanted.words:
        # SQLite folds ASCII only: of other letters those are found that are written as here, small, or large.
        spelt = {word, word.lower(), word.upper(), word.capitalize()}
        within = [place.icontains(one, autoescape=True) for place in places for one in sorted(spelt)]
        query = query.where(or_(row.kind.in_(kinds), *within))
    return query


def succeeded_evaluations(session: Session, version_id: str) -> list[str]:
    """Return the ids of the evaluations of a version that succeeded, newest first."""
    row = JobRow
    made = versions.get(session, version_id)
    query = select(row.id).where(
        row.robot_id == made.robot_id,
        row.kind == "evaluate",
        row.state == "succeeded",
        row.result["version_id"].as_string() == version_id,
    )
    return list(session.execute(query.order_by(row.created_at.desc(), row.id)).scalars())


def open_of_robots(session: Session) -> dict[str, int]:
    """Return how many jobs of each robot are not over."""
    counted = select(RobotRow.name, func.count()).select_from(JobRow).join(RobotRow, RobotRow.id == JobRow.robot_id)
    found = session.execute(robots.visible(counted.where(NOT_OVER).group_by(RobotRow.name)))
    return dict(found.all())


def _record(session: Session, row: JobRow) -> JobRecord:
    return copy_fields(
        JobRecord,
        row,
        robot=session.get_one(RobotRow, row.robot_id).name,
        request=JobRequest.from_document(row.request),
        asked=Asked(row.request_id, row.traceparent),
        asked_by=row.asked_by.get("actor", ""),
    )


def load(session: Session, job_id: str) -> JobInput:
    """Load all a job needs."""
    row = _row(session, job_id)
    return load_job_input(
        session, row.robot_id, row.kind, JobRequest.from_document(row.request), allowed=row.asked_by.get("robots")
    )


def load_job_input(
    session: Session,
    robot_id: int,
    kind_name: str,
    request: JobRequest,
    every: int = 1,
    allowed: Collection[str] | None = None,
) -> JobInput:
    """Load all that a request needs; of the rows of each campaign one in ``every``, of other robots those ``allowed``."""
    kind, robot = get_job_kind(kind_name), robots.core_robot(session, robot_id)
    named = starting_version(session, robot_id, kind, request)
    start = None if named is None else versions.calibration(session, named)
    masses = None
    if searched := request.options.get("masses_from"):
        job_id, name, model = ended.get_search_in_torques(session, robot_id, None if searched == NEWEST else searched)
        masses = name or job_id
        robot = core_motion.with_torques_told(robot, model)
        start = None if start is None else start.with_robot(robot)

    def load_rows(ids: Sequence[str]) -> dict[str, Observations]:
        return {c: campaigns.observations(session, c, robot, every=every) for c in ids}

    held, unstated = request.validation, _campaigns_without_load(session, request)
    return JobInput(
        robot=robot,
        campaigns=load_rows(request.campaigns),
        validation=request.folds if isinstance(held, dict) else load_rows(held) if isinstance(held, list) else held,
        options=read_options(kind_name, request.options),
        version_id=named,
        calibration=start,
        covariance=None if named is None else versions.covariance(session, named),
        report=None if named is None else dict(versions.get(session, named).report),
        names={c: campaigns.get(session, c).name for c in (*request.campaigns, *request.held_out_campaigns)},
        devices={c: campaigns.device(session, c) for c in (*request.campaigns, *request.held_out_campaigns)},
        instruments=campaigns.instruments(session, (*request.campaigns, *request.held_out_campaigns)),
        certificates=campaigns.certificates(
            session, (*request.campaigns, *request.held_out_campaigns, *request.confirmation)
        ),
        driven=campaigns.driven(session, robot_id, robot) if kind.contract.history else None,
        origin=_origin(session, named) if kind.contract.history and named is not None else None,
        fit=FitOfVersion() if named is None else _fit(session, named, kind, request),
        confirmation=load_rows(request.confirmation),
        default_load=() if robot.load is None else unstated,
        no_load=unstated if robot.load is None else (),
        masses_from=masses,
        made_from=frozenset() if named is None else versions.training_campaign_ids(session, named),
        fleet=versions.fleet_versions(session, robot_id, allowed) if request.options.get("prior") == "fleet" else (),
    )


def _fit(session: Session, version: str, kind: JobKind, request: JobRequest) -> FitOfVersion:
    """Return what a job's version was fitted to: against the rows that are judged, or those that judge what continues it."""
    if kind.contract.against_fit:
        return load_version_fit(session, version, request.campaigns)
    judging = [*request.held_out_campaigns, *request.confirmation]
    return load_version_fit(session, version, judging) if judging else FitOfVersion()


def _campaigns_without_load(session: Session, request: JobRequest) -> tuple[str, ...]:
    """Campaigns of a job that state no payload, so that the robot's default load counts, or none."""
    named = dict.fromkeys((*request.campaigns, *request.held_out_campaigns, *request.confirmation))
    return tuple(c for c in named if not campaigns.states_a_load(session, c))


def starting_version(session: Session, robot_id: int, kind: JobKind, request: JobRequest) -> str | None:
    """Return the version a job starts from: the one its options name, and for some kinds else the active one."""
    named = request.options.get(kind.contract.version_option) if kind.contract.version_option else None
    if named is None and kind.contract.version_option == "version":
        active = versions.active_entry(session, robot_id)
        named = None if active is None else active.version_id
    return named


def past_runs(session: Session, robot_id: int, kind: str) -> list[PastRun]:
    """Return the newest jobs of a kind that succeeded, of a robot; of all robots where it has none."""
    found = _past(session, kind, JobRow.robot_id == robot_id)
    return found or _past(session, kind, JobRow.robot_id != robot_id)


def _past(session: Session, kind: str, where: ColumnElement[bool]) -> list[PastRun]:
    row = JobRow
    query = select(row.started_at, row.finished_at, row.request).where(
        row.kind == kind, row.state == "succeeded", row.started_at.is_not(None), row.finished_at.is_not(None), where
    )
    out = []
    for started, finished, document in session.execute(query.order_by(row.created_at.desc()).limit(MOST_PAST)):
        request = JobRequest.from_document(document)
        rows = sum(upload.rows for c in request.input_campaigns for upload in campaigns.uploads_of_campaign(session, c))
        out.append(PastRun((finished - started).total_seconds(), rows, request))
    return out


def _origin(session: Session, version_id: str) -> dict[str, Any] | None:
    """Result of the job that made a version."""
    made = session.get(VersionRow, version_id)
    job = None if made is None else session.get(JobRow, made.job_id)
    return None if job is None else job.result


def job_requester(session: Session, job_id: str) -> dict[str, str]:
    """Return who asked for a job; empty for jobs of earlier releases."""
    return dict(_row(session, job_id).asked_by)


def succeed(
    session: Session,
    job_id: str,
    result: dict[str, Any],
    content: VersionContent | None,
    used: Sequence[UsedRecord] | None = None,
    objections: Sequence[Objection] = (),
) -> None:
    """Store the result and the version of a job; a job that is over already is left alone.

    ``used`` are the campaigns as they were when the job read them (None: as they are now), ``objections`` what the job
    says against activating its version.
    """
    row = _row(session, job_id)
    if row.state in FINAL:
        return
    used = campaigns_used_by_job(session, job_id) if used is None else used
    new = _version(session, row, content, result, used)
    if new is not None:
        version_id = versions.add(session, row.robot_id, job_id, new)
        result = {**result, "version_id": version_id, "objections": [one.model_dump() for one in objections]}
        if "figures" in result:
            robot = session.get_one(RobotRow, row.robot_id).name
            result["figures"] = add_captions(result["figures"], robot, [c.name or c.id for c in used], version_id)
    row.result = result
    _finish(session, row, "succeeded", "done", 1.0)


def fail(session: Session, job_id: str, code: str, message: str) -> None:
    """Store why a job failed; a job that is over already is left alone."""
    row = _row(session, job_id)
    if row.state not in FINAL:
        row.error = {"code": code, "message": message}
        _finish(session, row, "failed", "failed", row.fraction)


def cancel(session: Session, job_id: str) -> None:
    """Store that a job was cancelled; a job that is over already is left alone."""
    row = _row(session, job_id)
    if row.state not in FINAL:
        row.cancel_requested = True
        _finish(session, row, "cancelled", "cancelled", row.fraction)


def _finish(session: Session, row: JobRow, state: str, stage: str, fraction: float) -> None:
    row.state, row.stage, row.fraction = state, stage, fraction
    row.finished_at = max(utc_now(), row.started_at or utc_now())  # the clock may have been set back
    ended.count(session, row)


def campaigns_used_by_job(session: Session, job_id: str) -> list[UsedRecord]:
    """Return the campaigns a job uses, with the hashes of what was uploaded so far."""
    return campaigns_used_by_request(session, JobRequest.from_document(_row(session, job_id).request))


def campaigns_used_by_request(session: Session, request: JobRequest) -> list[UsedRecord]:
    """Return the campaigns a request names, with the hashes of what was uploaded so far."""
    named = {
        "train": request.campaigns,
        "validation": request.held_out_campaigns,
        "confirmation": request.confirmation,
    }
    return [_used_record(session, campaign, use) for use, campaigns_ in named.items() for campaign in campaigns_]


def _version(
    session: Session, row: JobRow, content: VersionContent | None, result: Mapping[str, Any], used: Sequence[UsedRecord]
) -> NewVersion | None:
    """Return the version that a job makes; one of a log of torques makes that which it starts from, with the torques found."""
    if content is None and not result.get(MOTION):
        return None
    request, kind = JobRequest.from_document(row.request), get_job_kind(row.kind)
    named = request.options.get(kind.contract.version_option) if kind.contract.version_option else None
    named = (content.parent_id if content is not None else None) or named
    start = None if named is None else versions.get(session, named)
    made_of = [asdict(one) for one in used]
    if content is None and start is not None and result.get(MOTION):
        content, made_of = _with_torques_found(start, row.name or row.id, result, made_of)
    if content is None:
        return None
    fields = {key: value for key, value in asdict(content).items() if key not in ("limits", "parent_id")}
    if start is not None:  # torques of a version are those of what continues it
        for part, stored in (("calibration", start.calibration), ("report", start.report)):
            fields[part] = {key: stored[key] for key in OF_TORQUES & stored.keys()} | fields[part]
    return NewVersion(
        **fields,
        limits=content.limits.model_dump(mode="json"),
        campaigns=made_of,
        parent_id=named,
        code_version=code_version(),
        name=row.request.get("name", row.name),
    )


def _with_torques_found(
    start: VersionRecord, name: str, result: Mapping[str, Any], logs: list[dict[str, Any]]
) -> tuple[VersionContent, list[dict[str, Any]]]:
    """A version with the torques that a search of this name found, and the campaigns that both are made of."""
    said = {MOTION: {**result[MOTION], "model": None}, TORQUES_FROM: name}
    warnings = [*(start.report.get("warnings") or ()), *(result.get("warnings") or ())]
    content = VersionContent(
        start.calibration | {TORQUES: result[MOTION]["model"]},
        start.report | said | {"warnings": warnings},
        start.covariance,
        CorrectionLimits(**start.limits),
    )
    return content, [*(c for c in start.campaigns if c["use"] != TORQUES), *(c | {"use": TORQUES} for c in logs)]


def _used_record(session: Session, campaign_id: str, use: str) -> UsedRecord:
    campaign, uploads = campaigns.get(session, campaign_id), campaigns.uploads_of_campaign(session, campaign_id)
    rows, hashes = sum(upload.rows for upload in uploads), [upload.sha256 for upload in uploads]
    return UsedRecord(campaign.id, campaign.name, campaign.role, use, rows, hashes)
