"""What each robot of a fleet job is identified from, or why it cannot be."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from pydantic import ValidationError

from kilter_core.errors import CoreError
from kilter_service.campaigns import store as campaigns
from kilter_service.campaigns.store import CampaignRecord
from kilter_service.contract.jobs.fleet import NewFleetJob
from kilter_service.contract.jobs.identify import IDENTIFY, IdentifyOptions
from kilter_service.contract.jobs.job import NewJobOf
from kilter_service.contract.written import as_written
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import ALL, Page
from kilter_service.jobs import service, store
from kilter_service.jobs.fleet.store import Planned
from kilter_service.jobs.kinds import identify
from kilter_service.robots import store as robots
from kilter_service.versions import store as versions

MOST = 1000  # robots of one fleet job: it is planned and queued within a request


def resolve_robot_names(session: Session, fleet: NewFleetJob) -> list[str]:
    """Return the names of the robots, each once.

    Raises:
        ServiceError: there are none, too many, or campaigns of a robot that is not among them.

    """
    if fleet.robots is None:
        found = [one.name for one in robots.robots_on_page(session, Page(limit=MOST))]
    else:
        found = [robots.get(session, name).name for name in dict.fromkeys(fleet.robots)]
    if not found:
        raise ServiceError("The fleet job names no robot: give at least one in `robots`.", code="robot_not_found")
    if len(found) > MOST:
        raise ServiceError(
            f"There are more than {MOST} robots: name at most {MOST} in `robots`, and ask again for the others.",
            code="option_invalid",
            option="robots",
        )
    strange = sorted(set(fleet.campaigns) - set(found))
    if strange:
        raise ServiceError(
            f"`campaigns` names robot {strange[0]!r}, which is not among the robots: add it to `robots`, or leave it out.",
            code="campaigns_invalid",
            robot=strange[0],
        )
    return found


def plan_robot_job(database: Database, fleet: NewFleetJob, robot: str) -> Planned:
    """Plan one robot; what its job would be refused with is its refusal."""
    with database.reading() as session:
        robot_id = robots.get(session, robot).id
        last = versions.active_entry(session, robot_id)
        before = None if last is None else last.version_id
        try:
            job = _job(session, fleet, robot, robot_id, before)
            service.validate_job(session, job, identify.KIND)
        except CoreError as error:
            return Planned(robot_id, before, refusal=(error.code, error.message))
    if fleet.options is None:  # those that are given for all were checked once
        try:
            identify.KIND.check(job.options)  # may import the core and take its time: outside
        except CoreError as error:
            return Planned(robot_id, before, refusal=(error.code, error.message))
    return Planned(robot_id, before, job)


def _job(
    session: Session, fleet: NewFleetJob, robot: str, robot_id: int, before: str | None
) -> NewJobOf[IdentifyOptions]:
    robots.refuse_retired_robot(session, robot_id)
    given = fleet.campaigns.get(robot)
    fitted, held = (given, []) if given is not None else _latest(session, robot, robot_id, before)
    return IDENTIFY.request(
        kind="identify",
        robot=robot,
        name=fleet.name,
        campaigns=fitted,
        validation=held or fleet.validation,
        options=fleet.options or _options(session, before),
    )


def _latest(session: Session, robot: str, robot_id: int, before: str | None) -> tuple[list[str], list[str]]:
    """The campaigns that the active version and those it continues were made from, and those since, by their roles.

    Raises:
        ServiceError: there is none to fit.

    """
    fitted, held, since = _of_version(session, before) if before else (set[str](), set[str](), None)
    there = _with_rows(session, robot_id)
    for one in there:
        if since is None or one.created_at > since:
            (fitted if one.role == "train" else held if one.role == "validation" else set()).add(one.id)
    in_use = [one.id for one in there]
    chosen = [c for c in in_use if c in fitted]
    if not chosen:
        raise ServiceError(
            f"Robot {robot!r} has no campaign to identify it from: upload one (kilter upload {robot} FILE), bring one back "
            "with `kilter measure campaigns restore`, or name campaigns.",
            code="campaigns_invalid",
            robot=robot,
        )
    return chosen, [c for c in in_use if c in held - fitted]


def _of_version(session: Session, version_id: str) -> tuple[set[str], set[str], datetime]:
    """Campaigns that were fitted and held out, and when that was asked for."""
    record = versions.get(session, version_id)
    fitted = {campaign for one in versions.trainings(session, version_id) for campaign, _ in one.campaigns}
    held = {used["id"] for used in record.campaigns if used["use"] == "validation"}
    return fitted, held, store.get(session, record.job_id).created_at


def _with_rows(session: Session, robot_id: int) -> Sequence[CampaignRecord]:
    found = campaigns.campaigns_on_page(session, robot_id, staged=False, page=ALL)
    return [one for one in found if campaigns.uploads_of_campaign(session, one.id)]


def _options(session: Session, before: str | None) -> IdentifyOptions:
    """The options of the identification that made a version; of another job those that identify the same effects.

    Raises:
        ServiceError: there is no version, or its effects cannot be asked for.

    """
    if before is None:
        return IdentifyOptions()
    record = versions.get(session, before)
    job = store.get(session, record.job_id)
    if job.kind == "identify":
        asked = {name: value for name, value in job.request.options.items() if name != "start"}
        return as_written(IdentifyOptions, asked)
    try:
        return IdentifyOptions.model_validate({"level": 3, "effects": record.calibration["effects"]})
    except ValidationError as error:
        raise ServiceError(
            f"Version {before} was made by a {job.kind} job, and its effects cannot be identified as they are: give "
            "`options`.",
            code="option_invalid",
            option="effects",
        ) from error
