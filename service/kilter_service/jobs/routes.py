"""Jobs and fleet jobs over HTTP."""

from __future__ import annotations

import asyncio
import hashlib
import logging
from collections.abc import AsyncGenerator, Iterator, Mapping
from contextlib import contextmanager
from contextvars import Context
from typing import Annotated, NamedTuple

from fastapi import APIRouter, FastAPI, Header, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.exceptions import RequestValidationError
from fastapi.responses import StreamingResponse

from kilter_service.contract.jobs.fleet import FleetJob, FleetJobList, FleetJobSummary, NewFleetJob
from kilter_service.contract.jobs.kind import FINAL, JobList
from kilter_service.contract.jobs.registry import Job, JobCheck, NewJob
from kilter_service.ground.db import Database
from kilter_service.ground.db.failures import Failing
from kilter_service.jobs import checking, service, store
from kilter_service.jobs.fleet import service as fleets
from kilter_service.jobs.refusals import refusal, without_kind
from kilter_service.web.auth.access import Admin
from kilter_service.web.auth.token import limit_event_stream
from kilter_service.web.routing import FOR_GOOD, ConditionalRoute, DatabaseOfApp, OnceOnly, PageOfJobs

# The life of jobs as server-sent events.
#
# One task looks at all jobs that are followed, with one query however many follow them; a follower waits for news
# and costs nothing meanwhile. An event's id is made from what it says: a follower that comes back with it, here or
# at another API process, is not told again what it knows.

log = logging.getLogger("kilter.api")

POLL_S = 0.2
ALIVE_S = 10.0


class News(NamedTuple):
    """An event: ``progress``, or ``end`` with the whole job when it is over."""

    name: str
    data: str

    @property
    def id(self) -> str:
        """The same for the same news, whoever tells it."""
        return hashlib.blake2s(f"{self.name} {self.data}".encode(), digest_size=8).hexdigest()

    def text(self) -> str:
        """Write the event."""
        return f"id: {self.id}\nevent: {self.name}\ndata: {self.data}\n\n"


class Followed:
    """A job that somebody follows: the latest news of it, and what to wait for."""

    def __init__(self) -> None:
        self.followers, self.progress = 0, ""
        self.latest: News | None = None
        self._told = asyncio.Event()

    def publish_news(self, news: News) -> None:
        """Wake all that wait."""
        self.latest = news
        self._told.set()
        self._told = asyncio.Event()

    async def wait_for_news(self, known: str | None) -> News | None:
        """Wait for news with another id than ``known``; None: there were none for some time."""
        if self.latest is None or self.latest.id == known:
            try:
                async with asyncio.timeout(ALIVE_S):
                    await self._told.wait()
            except TimeoutError:
                return None
        return self.latest


class Followers:
    """All jobs that are followed in this process."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._jobs: dict[str, Followed] = {}
        self._joined = asyncio.Event()
        self._task: asyncio.Task[None] | None = None
        self._looking = Failing(log, "the jobs that are followed cannot be read")

    async def events(self, job_id: str, known: str | None) -> AsyncGenerator[str, None]:
        """Yield the events of a job from now to its end; ``known`` is the id of the last that was received."""
        with self._following(job_id) as job:
            while True:
                news = await job.wait_for_news(known)
                if news is None:
                    yield ": still here\n\n"
                    continue
                if news.id != known:
                    yield news.text()
                if news.name == "end":
                    return
                known = news.id

    @contextmanager
    def _following(self, job_id: str) -> Iterator[Followed]:
        job = self._jobs.setdefault(job_id, Followed())
        job.followers += 1
        if job.latest is None:
            self._joined.set()
        if self._task is None or self._task.done():
            # In a context of its own: what its first follower may see must not limit what the others are told.
            self._task = asyncio.get_running_loop().create_task(self._watch(), context=Context())
        try:
            yield job
        finally:
            job.followers -= 1
            if not job.followers:
                self._jobs.pop(job_id, None)

    async def _watch(self) -> None:
        while self._jobs:
            self._joined.clear()
            await self._poll_jobs()
            try:
                async with asyncio.timeout(POLL_S):
                    await self._joined.wait()
            except TimeoutError:
                continue

    async def _poll_jobs(self) -> None:
        known = {job_id: job.progress for job_id, job in self._jobs.items()}
        try:
            found = await run_in_threadpool(_load_changed_jobs, self._database, known)
        except Exception as error:  # the database may be away for a while; the followers stay
            self._looking.report_failure(error)
            return
        self._looking.report_success()
        for job_id, (progress, news) in found.items():
            if job_id in self._jobs:
                self._jobs[job_id].progress = progress
                self._jobs[job_id].publish_news(news)


def _load_changed_jobs(database: Database, known: Mapping[str, str]) -> dict[str, tuple[str, News]]:
    """Return the progress and the news of the jobs whose progress is another than the one that is known."""
    with database.reading() as session:
        found = {job.id: (job.state, service.progress_json(job)) for job in store.progress(session, list(known))}
    changed = {job_id: (state, said) for job_id, (state, said) in found.items() if said != known[job_id]}
    return {job_id: (said, _news(database, job_id, state, said)) for job_id, (state, said) in changed.items()}


def _news(database: Database, job_id: str, state: str, said: str) -> News:
    if state in FINAL:
        return _end_event(service.get(database, job_id))
    return News("progress", said)


def _end_event(job: Job) -> News:
    return News("end", job.model_dump_json())


def has_received_end(job: Job, known: str | None) -> bool:
    """Whether a job is over, and whoever knows the event ``known`` was told so."""
    return known is not None and job.state in FINAL and _end_event(job).id == known


def get_job_followers(app: FastAPI) -> Followers:
    """Return the followers of an application's jobs."""
    if not hasattr(app.state, "followers"):
        app.state.followers = Followers(app.state.database)
    followers: Followers = app.state.followers
    return followers


class JobRoute(ConditionalRoute):
    """A route that takes jobs."""

    async def _parse_request_body(self, request: Request, body: bytes) -> Request:
        try:
            return await super()._parse_request_body(request, body)
        except RequestValidationError as error:
            found, document = error.errors(), error.body
            refused = refusal(found, document)
            if refused is not None:
                raise refused from error
            raise RequestValidationError(without_kind(found, document)) from error


router = APIRouter(prefix="/v1/jobs", tags=["jobs"], route_class=JobRoute)


@router.post("", status_code=202)
def submit(job: NewJob, response: Response, database: DatabaseOfApp, once: OnceOnly, _: Admin) -> Job:
    """Queue a job."""
    queued = service.submit(database, job, once)
    response.headers["Location"] = f"/v1/jobs/{queued.id}"
    return queued


@router.post("/check")
def check(job: NewJob, database: DatabaseOfApp) -> JobCheck:
    """Say what a job would do, at once: what it uses, what its data can tell, what is missing, how long it takes."""
    return checking.check(database, job)


@router.get("")
def listed(database: DatabaseOfApp, page: PageOfJobs, robot: str | None = None) -> JobList:
    """List the newest jobs."""
    return service.list_jobs(database, robot, page)


@router.get("/{job}")
def get(job: str, response: Response, database: DatabaseOfApp) -> Job:
    """Show a job and, when it is over, its result."""
    found = service.get(database, job)
    if found.state in FINAL:
        response.headers["Cache-Control"] = FOR_GOOD
    return found


@router.get(
    "/{job}/events",
    response_class=StreamingResponse,
    responses={
        200: {"content": {"text/event-stream": {}}, "description": "Events `progress`, then one `end`"},
        204: {"description": "`Last-Event-ID` is that of the end: there is no more to come"},
    },
)
async def follow(
    job: str,
    request: Request,
    database: DatabaseOfApp,
    last_event_id: Annotated[
        str | None, Header(max_length=64, description="Id of the last event received: what it said is not told again.")
    ] = None,
) -> Response:
    """Follow a job as server-sent events."""
    found = await run_in_threadpool(service.get, database, job)
    if has_received_end(found, last_event_id):
        return Response(status_code=204)
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    news = limit_event_stream(request, get_job_followers(request.app).events(job, last_event_id))
    return StreamingResponse(news, media_type="text/event-stream", headers=headers)


@router.post("/{job}/cancel")
def cancel(job: str, database: DatabaseOfApp, _: Admin) -> Job:
    """Stop a job."""
    return service.cancel(database, job)


fleet_router = APIRouter(prefix="/v1/fleet-jobs", tags=["jobs"], route_class=ConditionalRoute)


@fleet_router.post("", status_code=202)
def submit_fleet(
    fleet: NewFleetJob, response: Response, database: DatabaseOfApp, once: OnceOnly, _: Admin
) -> FleetJobSummary:
    """Queue a job for each of many robots, which identifies it anew."""
    queued = fleets.submit(database, fleet, once)
    response.headers["Location"] = f"/v1/fleet-jobs/{queued.id}"
    return queued


@fleet_router.get("")
def list_fleet_jobs(database: DatabaseOfApp, page: PageOfJobs) -> FleetJobList:
    """List the newest fleet jobs."""
    return fleets.list_fleet_jobs(database, page)


@fleet_router.get("/{fleet_job}")
def get_fleet(fleet_job: str, database: DatabaseOfApp) -> FleetJob:
    """Show how far a fleet job is, and what became of each robot."""
    return fleets.get(database, fleet_job)


@fleet_router.post("/{fleet_job}/cancel")
def cancel_fleet(fleet_job: str, database: DatabaseOfApp, _: Admin) -> FleetJob:
    """Cancel the jobs of a fleet job that are not over."""
    return fleets.cancel(database, fleet_job)
