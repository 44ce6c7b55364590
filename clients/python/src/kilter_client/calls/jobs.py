"""Calls about jobs: submit one, follow it to its end."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from kilter_client.calls.references import id_of, resolved_request
from kilter_client.errors import (
    ApiError,
    JobCancelledError,
    JobFailedError,
    JobTimeoutError,
    NotAuthorisedError,
    NotFoundError,
    ServerUnreachableError,
)
from kilter_client.steps import Document, Follow, LookAgain, Pause, Request, Steps, address, get, once, post, read

Progress = Callable[[float, str], None]

FINISHED = ("succeeded", "failed", "cancelled")
POLL_S = (0.1, 0.2, 0.5, 1.0)
# How long a wait goes on without an answer: a server that is started again is ready within seconds, on a busy machine
# that compiles its kernels within a minute or two.
PATIENCE_S = 120.0
LOOK_TIMEOUT_S = 10.0
AWAY = f"the server does not answer, waiting up to {PATIENCE_S:.0f} s for it"


def asked(
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
    return (yield from post("/v1/jobs", request, once()))


def check(robot: str, body: Mapping[str, Any]) -> Steps[Document]:
    """Ask what a job would do; nothing is stored, nothing queued."""
    request = yield from resolved_request(robot, body)
    return (yield from post("/v1/jobs/check", request))


def listed(robot: str | None = None, limit: int = 100) -> Steps[list[Document]]:
    """Return the newest jobs."""
    wanted: Document = {"limit": limit} | ({"robot": robot} if robot else {})
    found = yield from get("/v1/jobs", **wanted)
    return list(found["jobs"])


def one(job: str, robot: str | None = None) -> Steps[Document]:
    """Return a job's document."""
    found = yield from id_of("job", job, robot)
    return (yield from get(address("jobs", found)))


def cancel(job: str, robot: str | None = None) -> Steps[Document]:
    """Ask a job to stop."""
    found = yield from id_of("job", job, robot)
    return (yield from post(address("jobs", found, "cancel")))


def wait(job: str, progress: Progress | None, timeout_s: float | None, robot: str | None = None) -> Steps[Document]:
    """Follow a job to its end and return its document: by its events; when they break or are refused, by looking."""
    found = yield from id_of("job", job, robot)
    watch = _Watch(found, progress, timeout_s)
    try:
        yield Follow(address("jobs", found, "events"), watch.told)
    except (ServerUnreachableError, ApiError) as error:
        if isinstance(error, NotFoundError | NotAuthorisedError):
            raise
    if watch.last.get("state") not in FINISHED:
        yield from _looked_at(found, watch)
    return succeeded(watch.last if "result" in watch.last else (yield from one(found)))


class _Watch:
    """What was last heard of a job, handed on to whoever wants to see its progress."""

    def __init__(self, job_id: str, progress: Progress | None, timeout_s: float | None) -> None:
        self.last: Document = {}
        self._job_id, self._progress, self._timeout_s = job_id, progress, timeout_s
        self._deadline = None if timeout_s is None else time.monotonic() + timeout_s

    def told(self, document: Document) -> bool:
        """Take news of the job; whether it has ended."""
        self.last = document
        if self._progress is not None:
            self._progress(*progress_of(document))
        if document.get("state") in FINISHED:
            return True
        self._in_time(str(document.get("state")))
        return False

    def away(self) -> None:
        """Take that there was no answer."""
        if self._progress is not None:
            self._progress(progress_of(self.last)[0], AWAY)
        self._in_time("without an answer")

    def _in_time(self, state: str) -> None:
        if self._deadline is not None and time.monotonic() > self._deadline:
            raise JobTimeoutError(
                f"Job {self._job_id} is still {state} after {self._timeout_s:g} s.", job_id=self._job_id
            )


def _looked_at(job_id: str, watch: _Watch) -> Steps[None]:
    """Look at the job's document until it has ended, through a restart of the server within ``PATIENCE_S``."""
    looks, heard = 0, time.monotonic()
    while True:
        try:
            job = yield from read(Request("GET", address("jobs", job_id), timeout_s=LOOK_TIMEOUT_S))
        except (ServerUnreachableError, ApiError) as error:
            if not _may_pass(error):
                raise
            if time.monotonic() - heard > PATIENCE_S:
                raise _gone(job_id) from error
            yield LookAgain()
            watch.away()
        else:
            heard = time.monotonic()
            if watch.told(job):
                return
        yield Pause(POLL_S[min(looks, len(POLL_S) - 1)])
        looks += 1


def _may_pass(error: ServerUnreachableError | ApiError) -> bool:
    """Whether an error is one of a server that starts, stops or is busy, so that asking again may help."""
    return isinstance(error, ServerUnreachableError) or (error.status or 0) >= 500


def _gone(job_id: str) -> ServerUnreachableError:
    return ServerUnreachableError(
        f"The server has not answered for {PATIENCE_S:.0f} s. Job {job_id} is stored there and continues when it is back: "
        f"`kilter jobs watch {job_id}` follows it.",
        job_id=job_id,
    )


def succeeded(job: Document) -> Document:
    """Return a finished job, or raise what it failed with."""
    state = job.get("state")
    if state == "succeeded":
        return job
    error = job.get("error") or {}
    said = error.get("message") or error.get("detail")
    if state == "cancelled":
        raise JobCancelledError(str(said or f"Job {job.get('id')} was cancelled."), job=job)
    raise JobFailedError(str(said or f"Job {job.get('id')} is {state}."), job=job, code=error.get("code"))


def progress_of(job: Document) -> tuple[float, str]:
    """Return the fraction that is done, and the stage."""
    progress = job.get("progress") or job
    return float(progress.get("fraction") or 0.0), str(progress.get("stage") or job.get("state") or "")
