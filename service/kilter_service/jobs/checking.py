"""What a job would do: the checks of posting it, then the beginning of its work. Nothing is stored, nothing is queued."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass

from kilter_core.errors import CoreError
from kilter_service.campaigns import store as campaigns
from kilter_service.campaigns.keeping import REMEDY
from kilter_service.contract.jobs.check import CheckedCampaign
from kilter_service.contract.jobs.registry import JobCheck, NewJob
from kilter_service.ground.db import Database, Session
from kilter_service.ground.naming import copy_fields
from kilter_service.jobs import service, store
from kilter_service.jobs.durations import PastRun, duration
from kilter_service.jobs.kind import JobInput, JobKind, JobPreview, Lack, count_poses
from kilter_service.jobs.records import JobRequest
from kilter_service.jobs.registry import get_job_kind
from kilter_service.jobs.setups import find_unstated_load, load_not_stated

MOST_ROWS = 100_000  # read of all campaigns together; what takes more is thinned

_ONE_AT_A_TIME = threading.Lock()  # a check holds the rows of a job


@dataclass(frozen=True)
class _Loaded:
    """All that a check reads from the database; ``why`` there is no input, when loading it would fail."""

    robot_id: int
    version: str | None
    used: list[CheckedCampaign]
    past: list[PastRun]
    every: int
    given: JobInput | None
    why: CoreError | None


def check(database: Database, job: NewJob) -> JobCheck:
    """Say what a job would do.

    Raises:
        ServiceError, CoreError: what posting it would be refused with.

    """
    kind, request = get_job_kind(job.kind), JobRequest.from_document(job.model_dump(mode="json"))
    with database.reading() as session:
        service.validate_job(session, job, kind)
    kind.check(job.options)  # may import the core and take its time: outside
    with _ONE_AT_A_TIME:
        with database.reading() as session:
            loaded = _load(session, job, kind, request)
        found = _preview(kind, loaded)
    rows = sum(campaign.rows for campaign in loaded.used if campaign.use != "confirmation")
    expected = duration(job.kind, rows, request, loaded.past, found.seconds)
    return service.describe_check(job.kind, job.robot, loaded.version, found, loaded.used, expected)


def _load(session: Session, job: NewJob, kind: JobKind, request: JobRequest) -> _Loaded:
    robot_id = service.validate_job(session, job, kind)
    used = store.campaigns_used_by_request(session, request)
    every = max(1, math.ceil(sum(one.rows for one in used) / MOST_ROWS))
    given, why = None, None
    try:
        given = store.load_job_input(session, robot_id, job.kind, request, every)
    except CoreError as error:
        why = error
    rows = {} if given is None else given.rows_by_campaign
    return _Loaded(
        robot_id,
        store.starting_version(session, robot_id, kind, request),
        [
            copy_fields(
                CheckedCampaign,
                one,
                device=campaigns.device(session, one.id),
                poses=count_poses(rows[one.id]) if one.id in rows else None,
            )
            for one in used
        ],
        store.past_runs(session, robot_id, job.kind),
        every,
        given,
        why,
    )


def _preview(kind: JobKind, loaded: _Loaded) -> JobPreview:
    found = JobPreview()
    if loaded.every > 1:
        found.limited.append(
            f"One row in {loaded.every} was read, because there are more than {MOST_ROWS}: rows and poses are counted among "
            "those, and all of them together show more."
        )
    if loaded.why is not None:
        found.problems.append(loaded.why)
    elif loaded.given is not None and kind.preview_job is not None:
        kind.preview_job(loaded.given, found)
        load = find_unstated_load(kind.name, loaded.given)
        if load is not None:
            why = load.message({load.code: load_not_stated})
            found.missing.append(Lack("payload_kg", why, REMEDY.format(whole="campaign")))
    elif loaded.given is not None:
        found.count_fitted_rows(*loaded.given.campaigns.values())
    return found
