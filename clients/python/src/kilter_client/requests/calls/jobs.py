"""Calls about jobs: submit one, follow it to its end.

Calls about fleet jobs: many robots identified anew by one request.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from kilter_client.errors import (
    ApiError,
    JobCancelledError,
    JobFailedError,
    JobTimeoutError,
    NotAuthorisedError,
    NotFoundError,
    ServerUnreachableError,
)
from kilter_client.requests.calls.references import resolve_id, resolved_request
from kilter_client.requests.steps import (
    Document,
    Follow,
    Pause,
    Relocate,
    Request,
    Steps,
    address,
    get,
    idempotency_header,
    post,
    read,
    send_with_retries,
)

Progress = Callable[[float, str], None]

FINISHED = ("succeeded", "failed", "cancelled")
POLL_S = (0.1, 0.2, 0.5, 1.0)
MOST_BREAKS = 5  # of events, one after another without news: something on the way lets none through
# How long a wait goes on without an answer: a server that is started again is ready within seconds, on a busy machine
# that compiles its kernels within a minute or two.
PATIENCE_S = 120.0
LOOK_TIMEOUT_S = 10.0
AWAY = f"the server does not answer, waiting up to {PATIENCE_S:.0f} s for it"


def request_body(
    kind: str,
    robot: str,
    campaigns: Sequence[str],
    validation: Any,
    options: Mapping[str, Any] | None,
    confirmation: Sequence[str] = (),
    name: str = "",
) -> Document:
    """Return the request for a job; what is not given is not in it."""
    body: Document = {"kind": kind, "robot": robot, "campaigns": list(campaigns), "options": dict(options or {})}
    if validation is not None:
        body["validation"] = validation
    return body | ({"confirmation": list(confirmation)} if confirmation else {}) | ({"name": name} if name else {})


def submit(robot: str, body: Mapping[str, Any]) -> Steps[Document]:
    """Ask for a job and return its document, still queued."""
    request = yield from resolved_request(robot, body)
    return (yield from post("/v1/jobs", request, idempotency_header()))


def check(robot: str, body: Mapping[str, Any]) -> Steps[Document]:
    """Ask what a job would do; nothing is stored, nothing queued."""
    request = yield from resolved_request(robot, body)
    return (yield from post("/v1/jobs/check", request, again=True))


def list_jobs(robot: str | None = None, limit: int = 100) -> Steps[list[Document]]:
    """Return the newest jobs, of one robot or of all."""
    found = yield from get("/v1/jobs", limit=limit, robot=robot or None)
    return list(found["jobs"])


def fetch_document(job: str, robot: str | None = None) -> Steps[Document]:
    """Return a job's document; the id may be its beginning, a name, or ``latest`` with its robot."""
    found = yield from resolve_id("job", job, robot)
    return (yield from get(address("jobs", found)))


def cancel(job: str, robot: str | None = None) -> Steps[Document]:
    """Ask a job to stop."""
    found = yield from resolve_id("job", job, robot)
    return (yield from post(address("jobs", found, "cancel")))


def wait(
    job: str, progress: Progress | None = None, timeout_s: float | None = None, robot: str | None = None
) -> Steps[Document]:
    """Follow a job to its end and return its document with the result, through a restart of the server too.

    It is followed by its events; when they are refused, or break off before they say anything, by looking.

    Raises:
        JobFailedError: it failed; the document is the exception's ``job``.
        JobCancelledError: it was cancelled.
        JobTimeoutError: it goes on after ``timeout_s``.
        ServerUnreachableError: the server gave no answer for two minutes; the job is stored there.

    """
    found = yield from resolve_id("job", job, robot)
    watch = Watch(found, progress, timeout_s)
    yield from _follow_events(found, watch)
    if not watch.over:
        yield from poll_until_finished(address("jobs", found), watch)
    return require_success(watch.last if "result" in watch.last else (yield from fetch_document(found)))


def _follow_events(job_id: str, watch: Watch) -> Steps[None]:
    """Follow the events, each time from the last one that was heard, for as long as they bring news."""
    follow, breaks = Follow(address("jobs", job_id, "events"), watch.process_news), 0
    while True:
        known = follow.events.last_id
        try:
            yield follow
        except (ServerUnreachableError, ApiError) as error:
            if isinstance(error, NotFoundError | NotAuthorisedError):
                raise
            if not _may_pass(error):
                return
        breaks = 0 if follow.events.last_id != known else breaks + 1
        if watch.over or not follow.events.last_id or breaks > MOST_BREAKS:
            return
        yield from poll_until_finished(address("jobs", job_id), watch, until_answered=True)
        if watch.over:
            return
        yield Pause(POLL_S[min(breaks, len(POLL_S) - 1)])


class Watch:
    """What was last heard of a job, handed on to whoever wants to see its progress."""

    def __init__(
        self, job_id: str, progress: Progress | None, timeout_s: float | None, command: str = "kilter server jobs watch"
    ) -> None:
        self.last: Document = {}
        self._job_id, self._progress, self._timeout_s, self._command = job_id, progress, timeout_s, command
        self._deadline = None if timeout_s is None else time.monotonic() + timeout_s

    @property
    def over(self) -> bool:
        """Whether the job has ended, as far as was heard."""
        return self.last.get("state") in FINISHED

    def process_news(self, document: Document) -> bool:
        """Take news of the job; whether it has ended."""
        self.last = document
        if self._progress is not None:
            self._progress(*progress_and_stage(document))
        if self.over:
            return True
        self._in_time(str(document.get("state")))
        return False

    def note_no_answer(self) -> None:
        """Take that there was no answer."""
        if self._progress is not None:
            self._progress(progress_and_stage(self.last)[0], AWAY)
        self._in_time("without an answer")

    def gone(self, request_id: str | None) -> ServerUnreachableError:
        """Return what to raise when there was no answer for too long."""
        error = ServerUnreachableError(
            f"The server has not answered for {PATIENCE_S:.0f} s. Job {self._job_id} is stored there and continues when it "
            f"is back: `{self._command} {self._job_id}` follows it.",
            job_id=self._job_id,
        )
        error.request_id = request_id
        return error

    def _in_time(self, state: str) -> None:
        if self._deadline is not None and time.monotonic() > self._deadline:
            raise JobTimeoutError(
                f"Job {self._job_id} is still {state} after {self._timeout_s:g} s.", job_id=self._job_id
            )


def poll_until_finished(path: str, watch: Watch, until_answered: bool = False) -> Steps[None]:
    """Look at the job's document until it has ended, through a restart of the server within ``PATIENCE_S``.

    With ``until_answered`` only until the server is back: what a job that goes on does, its events tell.
    """
    looks, heard = 0, time.monotonic()
    request = Request("GET", path, timeout_s=LOOK_TIMEOUT_S, patience_s=0.0)
    while True:
        try:
            job = yield from read(request)
        except (ServerUnreachableError, ApiError) as error:
            if not _may_pass(error):
                raise
            if time.monotonic() - heard > PATIENCE_S:
                raise watch.gone(error.request_id) from error
            yield Relocate()
            watch.note_no_answer()
        else:
            heard = time.monotonic()
            if until_answered and job.get("state") not in FINISHED:
                return
            if watch.process_news(job):
                return
        yield Pause(POLL_S[min(looks, len(POLL_S) - 1)])
        looks += 1


def report_page(job_id: str) -> Steps[bytes]:
    """Return the report of a job as one HTML page that needs no other file."""
    answer = yield from send_with_retries(Request("GET", f"/jobs/{job_id}/report.html"))
    return answer.content


def _may_pass(error: ServerUnreachableError | ApiError) -> bool:
    """Whether an error is one of a server that starts, stops or is busy, so that asking again may help."""
    return isinstance(error, ServerUnreachableError) or (error.status or 0) >= 500


def require_success(job: Document) -> Document:
    """Return a finished job, or raise what it failed with."""
    state = job.get("state")
    if state == "succeeded":
        return job
    error = job.get("error") or {}
    said = error.get("message") or error.get("detail")
    if state == "cancelled":
        raise JobCancelledError(str(said or f"Job {job.get('id')} was cancelled."), job=job)
    raise JobFailedError(str(said or f"Job {job.get('id')} is {state}."), job=job, code=error.get("code"))


def progress_and_stage(job: Document) -> tuple[float, str]:
    """Return the fraction that is done, and the stage."""
    progress = job.get("progress") or job
    return float(progress.get("fraction") or 0.0), str(progress.get("stage") or job.get("state") or "")


PLACE = "fleet-jobs"
SUBMIT_TIMEOUT_S = 300.0  # a thousand robots are looked at before the answer
FOLLOW = "kilter robot fleet watch"


def identify_fleet(
    robots: Sequence[str] | None = None,
    *,
    campaigns: Mapping[str, Sequence[str]] | None = None,
    validation: float | None = None,
    options: Mapping[str, Any] | None = None,
    name: str = "",
) -> Steps[Document]:
    """Identify many robots anew, each by a job of its own; returns the fleet job, still queued. Nothing is activated.

    Args:
        robots: names of the robots; None: all that are in use.
        campaigns: ids of the campaigns to use, by robot. Of a robot that is not named: those that its active version was
            made from and what was measured since.
        validation: fraction of the poses that is held out where nobody measured for validation; None: 0.2.
        options: options of all identifications; None: for each robot those of its active version.
        name: name of the fleet job, its jobs and the versions they make.

    Raises:
        NotFoundError: a robot that does not exist.

    """
    body: Document = {"robots": None if robots is None else [*robots], "name": name}
    body |= {"campaigns": {robot: [*ids] for robot, ids in (campaigns or {}).items()}}
    body |= {} if validation is None else {"validation": validation}
    body |= {} if options is None else {"options": dict(options)}
    request = Request("POST", f"/v1/{PLACE}", body=body, headers=idempotency_header(), timeout_s=SUBMIT_TIMEOUT_S)
    return read(request)


def fleet_jobs(limit: int = 100) -> Steps[list[Document]]:
    """Return the newest fleet jobs, without the rows of their robots."""
    found = yield from get(f"/v1/{PLACE}", limit=limit)
    return list(found["fleet_jobs"])


def fleet_job(fleet_job: str) -> Steps[Document]:
    """Return a fleet job; its ``report`` has a row for each robot: version, errors before and after, or why there is none.

    Raises:
        NotFoundError: there is none.

    """
    return get(address(PLACE, fleet_job))


def wait_for_fleet(
    fleet_job: str, *, progress: Progress | None = None, timeout_s: float | None = None
) -> Steps[Document]:
    """Follow a fleet job until all its jobs are over, and return it, however they ended.

    Raises:
        JobTimeoutError: it goes on after ``timeout_s``.
        ServerUnreachableError: the server gave no answer for two minutes; the jobs are stored there.

    """
    watch = Watch(fleet_job, progress, timeout_s, FOLLOW)
    yield from poll_until_finished(address(PLACE, fleet_job), watch)
    return watch.last


def cancel_fleet(fleet_job: str) -> Steps[Document]:
    """Cancel the jobs of a fleet job that are not over; versions that were made stay.

    Raises:
        NotFoundError: there is none. ConflictError: all are over.

    """
    return post(address(PLACE, fleet_job, "cancel"))
