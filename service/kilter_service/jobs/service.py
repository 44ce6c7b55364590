"""What can be done with jobs."""

from __future__ import annotations

from typing import Any

from pydantic import TypeAdapter

from kilter_service.campaigns import store as campaigns
from kilter_service.contract.jobs.check import NEWEST, CheckedCampaign, Duration, HeldOut, JobProblem, Missing
from kilter_service.contract.jobs.kind import FINAL, Folds, JobError, JobList, JobSummary, Progress
from kilter_service.contract.jobs.registry import Job, JobCheck, NewJob
from kilter_service.contract.wording import as_written
from kilter_service.ground import store as references
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import copy_fields, display_name
from kilter_service.ground.paging import Page, in_time
from kilter_service.jobs import store
from kilter_service.jobs.kind import JobKind, JobPreview
from kilter_service.jobs.records import Asked, JobRecord, ListedJob, Place, ProgressRecord, WantedJobs
from kilter_service.jobs.registry import get_job_kind
from kilter_service.robots import store as robots
from kilter_service.versions import store as versions
from kilter_service.web import logs
from kilter_service.web.routing import NOT_REPEATED, Once, hash_document

JOB: TypeAdapter[Job] = TypeAdapter(Job)


def submit(database: Database, job: NewJob, once: Once = NOT_REPEATED) -> Job:
    """Check a job and queue it.

    Raises:
        ServiceError: no such kind, robot, campaign or version, or campaigns that do not fit.
        CoreError: options the kind does not have.

    """
    kind = get_job_kind(job.kind)
    body = hash_document(job)
    with database.reading() as session:
        known = once.first_answer(session, body, JOB)
        if known is not None:
            return known
        job = _with_searched_masses(session, _with_version_id(session, job, kind))
        validate_job(session, job, kind)
    kind.check(job.options)  # may import the core and take its time: outside
    with database.transaction() as session:
        known = once.first_answer(session, body, JOB)
        if known is not None:
            return known
        asked = Asked(logs.request_id(), logs.traceparent())
        job_id = store.add(session, validate_job(session, job, kind), job, asked)  # robot and campaigns are still there
        queued = once.keep(session, body, describe_job(store.get(session, job_id)))
    return queued


def _with_version_id(session: Session, job: NewJob, kind: JobKind) -> NewJob:
    """Return a job whose version is named by its id: it may be asked for as `tour v2`."""
    option = kind.contract.version_option
    named = getattr(job.options, option) if option else None
    if named is None:
        return job
    options = job.options.model_copy(update={option: references.version_id(session, str(named))})
    return job.model_copy(update={"options": options})


def _with_searched_masses(session: Session, job: NewJob) -> NewJob:
    """Return a job that names the search in torques whose masses it takes by its id, where it asks for the newest."""
    named = getattr(job.options, "masses_from", None)
    if named is None:
        return job
    robot_id = robots.usable(session, job.robot).id
    found, *_ = references.get_search_in_torques(session, robot_id, None if named == NEWEST else named)
    return job.model_copy(update={"options": job.options.model_copy(update={"masses_from": found})})


def validate_job(session: Session, job: NewJob, kind: JobKind) -> int:
    """Return the key of a job's robot, whose campaigns and version exist and fit.

    Raises:
        ServiceError: they do not.

    """
    robot_id = robots.usable(session, job.robot).id
    if job.name:
        references.check_name(session, "job", robot_id, job.name)
        references.check_name(session, "version", robot_id, job.name)
    _check_campaigns(session, robot_id, job, kind)
    version = getattr(job.options, kind.contract.version_option) if kind.contract.version_option else None
    if version is not None:
        _check_version(session, robot_id, str(version))
    return robot_id


def _check_campaigns(session: Session, robot_id: int, job: NewJob, kind: JobKind) -> None:
    held = job.validation if isinstance(job.validation, list) else []
    for campaign in [*job.campaigns, *held, *job.confirmation]:
        if campaigns.usable(session, campaign).robot_id != robot_id:
            raise ServiceError(
                f"Campaign {campaign} is not of robot {job.robot!r}: name campaigns of that robot.",
                code="campaigns_invalid",
                campaign=campaign,
            )
    others = [name for name in kind.contract.instead_of_campaigns if getattr(job.options, name)]
    if not job.campaigns and kind.contract.needs_campaigns and not others:
        instead = "".join(f", or {name} in `options`" for name in kind.contract.instead_of_campaigns)
        raise ServiceError(
            f"The job names no campaign: give at least one in `campaigns`{instead}.", code="campaigns_invalid"
        )
    if job.campaigns and others:
        raise ServiceError(
            f"A {kind.name} job takes campaigns or {others[0]}, not both: make two jobs.", code="campaigns_invalid"
        )
    if kind.contract.most_campaigns is not None and len(job.campaigns) > kind.contract.most_campaigns:
        raise ServiceError(
            f"The job names {len(job.campaigns)} campaigns, and a {kind.name} job takes {kind.contract.most_campaigns}: "
            "make a job of each.",
            code="campaigns_invalid",
        )
    if isinstance(job.validation, Folds) and not kind.contract.takes_folds:
        raise ServiceError(
            f"A {kind.name} job takes no folds: name campaigns in `validation`, give a fraction of the poses, or "
            "leave it out: then each pose is held out in turn.",
            code="option_invalid",
            option="validation",
        )
    if job.validation == 0 and not kind.contract.takes_confirmation:
        raise ServiceError(
            f"validation is 0: a {kind.name} job holds nothing out by itself. Leave validation out.",
            code="option_invalid",
            option="validation",
        )
    if job.confirmation and not kind.contract.takes_confirmation:
        raise ServiceError(
            f"A {kind.name} job takes no confirmation: only gap does. Evaluate the version against the campaign instead.",
            code="option_invalid",
            option="confirmation",
        )
    _refuse_shared(session, job.campaigns, held, "validation", "what was used to identify cannot validate")
    _refuse_shared(
        session, [*job.campaigns, *held], job.confirmation, "confirmation", "what chose a name cannot confirm it"
    )


def _refuse_shared(session: Session, ids: list[str], others: list[str], use: str, why: str) -> None:
    """Refuse campaigns that judge what they are part of: the same one, or the same file in another."""
    known = {**{campaign: campaign for campaign in ids}, **_hashes(session, ids)}
    shared = sorted(set(known) & {*others, *_hashes(session, others)})
    if shared:
        raise ServiceError(
            f"The same rows are in {known[shared[0]]} and in `{use}`: {why}. Name other campaigns"
            + (", or give a fraction." if use == "validation" else "."),
            code="campaigns_invalid",
            campaign=known[shared[0]],
        )


def _hashes(session: Session, ids: list[str]) -> dict[str, str]:
    return {upload.sha256: campaign for campaign in ids for upload in campaigns.uploads_of_campaign(session, campaign)}


def _check_version(session: Session, robot_id: int, version: str) -> None:
    if versions.usable(session, version).robot_id != robot_id:
        raise ServiceError(f"Version {version} is of another robot.", code="option_invalid", version=version)


def get(database: Database, job_id: str) -> Job:
    """Return a job."""
    with database.reading() as session:
        return describe_job(store.get(session, job_id))


def list_jobs(database: Database, robot: str | None, page: Page) -> JobList:
    """List the newest jobs."""
    with database.reading() as session:
        found = store.newest_jobs(session, robot, page)
    shown, cursor = page.cut(found, lambda job: in_time(job.created_at, job.id))
    return JobList(jobs=[summarise_job(job) for job in shown], next=cursor)


def find_jobs(
    database: Database, wanted: WantedJobs, page: int, at_once: int
) -> tuple[list[JobSummary], int, int, int]:
    """Return a page of the jobs that are wanted, its number (of the last page where there are fewer), how many are as
    wanted, and how many there are at all.
    """
    with database.reading() as session:
        count, total = store.count_jobs(session, wanted)
        at = min(page, max(-(-count // at_once), 1))
        found = store.wanted_jobs(session, wanted, (at - 1) * at_once, at_once)
    return [summarise_job(job) for job in found], at, count, total


def succeeded_evaluations(database: Database, version_id: str) -> list[str]:
    """Return the ids of the evaluations of a version that succeeded, newest first, however many jobs came after them."""
    with database.reading() as session:
        return store.succeeded_evaluations(session, version_id)


def list_searches_in_torques(database: Database, robot: str, limit: int) -> list[tuple[str, str]]:
    """Return id and name of the searches in torques whose masses and torques a robot can take, the newest first."""
    with database.reading() as session:
        return references.list_searches_in_torques(session, robots.usable(session, robot).id, limit)


def open_of_robots(database: Database) -> dict[str, int]:
    """Return how many jobs of each robot are not over."""
    with database.reading() as session:
        return store.open_of_robots(session)


def places(database: Database) -> dict[str, Place]:
    """Return where the jobs stand that are not over, by their ids."""
    with database.reading() as session:
        return store.places(session)


def cancel(database: Database, job_id: str) -> Job:
    """Stop a job; one that was cancelled before stays so.

    Raises:
        ServiceError: it has finished otherwise.

    """
    with database.transaction() as session:
        row = store.get(session, job_id)
        if row.state in FINAL and row.state != "cancelled":
            raise ServiceError(f"Job {job_id} has {row.state}: nothing is left to cancel.", code="job_finished")
        store.cancel(session, job_id)  # the worker, if one lives, notices at its next progress report
    return get(database, job_id)


def progress_json(record: ProgressRecord) -> str:
    """Write how far a job is, as its events say it."""
    told = copy_fields(Progress, record)
    return f'{{"id":"{record.id}","state":"{record.state}","progress":{told.model_dump_json()}}}'


def describe_job(record: JobRecord) -> Job:
    """Say all of a job; what an earlier release wrote in another form is left out."""
    kind = get_job_kind(record.kind).contract
    return copy_fields(
        kind.job,
        record,
        **_read_out(record),
        campaigns=record.request.campaigns,
        validation=record.request.validation,
        confirmation=record.request.confirmation,
        options=as_written(kind.options, record.request.options),
        result=None if record.result is None else as_written(kind.result, record.result),
    )


def summarise_job(record: ListedJob) -> JobSummary:
    """Say what lists tell of a job."""
    return copy_fields(JobSummary, record, **_read_out(record))


def _read_out(record: ListedJob) -> dict[str, Any]:
    """What a list tells that no field of the record holds."""
    return {
        "name": display_name(record),
        "progress": copy_fields(Progress, record),
        "error": None if record.error is None else JobError(**record.error),
    }


def describe_check(
    kind: str, robot: str, version: str | None, found: JobPreview, campaigns: list[CheckedCampaign], duration: Duration
) -> JobCheck:
    """Say what a job would do."""
    job_kind = get_job_kind(kind)
    return job_kind.contract.preview(
        kind=kind,
        robot=robot,
        version=version,
        would_run=not found.problems,
        problems=[copy_fields(JobProblem, error) for error in found.problems],
        campaigns=campaigns,
        rows=found.rows,
        poses=found.poses,
        held_out=HeldOut(how=found.how, rows=found.held_rows, poses=found.held_poses),
        missing=[copy_fields(Missing, one) for one in found.missing],
        limited=found.limited,
        duration_s=duration,
        **job_kind.describe_preview(found),
    )
