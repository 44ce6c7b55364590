"""Jobs: ask for one, follow it, take its result."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from kilter_client.connection import Connection, Document, address
from kilter_client.errors import (
    ApiError,
    JobCancelledError,
    JobFailedError,
    JobTimeoutError,
    NotAuthorisedError,
    NotFoundError,
    ServerUnreachableError,
)
from kilter_client.references import id_of, resolved_request

Progress = Callable[[float, str], None]
Validation = Sequence[str] | float | Mapping[str, int] | None

FINISHED = ("succeeded", "failed", "cancelled")
POLL_S = (0.1, 0.2, 0.5, 1.0)
# How often in a row a wait may find no server before it gives up: a restart takes some seconds.
MAX_SILENCES = 10


class Jobs:
    """The jobs of a server."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def submit(
        self,
        kind: str,
        robot: str,
        campaigns: Sequence[str] = (),
        validation: Validation = None,
        options: Mapping[str, Any] | None = None,
        confirmation: Sequence[str] = (),
        name: str = "",
    ) -> Document:
        """Ask for a job (identify, gap, evaluate, plan, joint_parameters) and return its document, still queued.

        ``confirmation`` are campaigns of another day or set-up in which a gap hunt must see again what it found.
        Campaigns and versions may be named by the beginning of an id, a name, or ``latest``. ``name`` is that of the job
        and of the version it makes.
        """
        body = _request(kind, robot, campaigns, validation, options, confirmation, name)
        return self._connection.post("/v1/jobs", resolved_request(self._connection, robot, body))

    def check(
        self,
        kind: str,
        robot: str,
        campaigns: Sequence[str] = (),
        validation: Validation = None,
        options: Mapping[str, Any] | None = None,
        confirmation: Sequence[str] = (),
        name: str = "",
    ) -> Document:
        """Say what such a job would do, at once: nothing is stored, nothing queued.

        The document has ``would_run`` and ``problems``, what is used and held out, ``missing``, ``duration_s``; of
        ``identify`` also ``identifiability``, of ``gap`` ``testability``.
        """
        body = _request(kind, robot, campaigns, validation, options, confirmation, name)
        return self._connection.post("/v1/jobs/check", resolved_request(self._connection, robot, body))

    def list(self, robot: str | None = None, limit: int = 100) -> list[Document]:
        """Return the newest jobs, of one robot or of all."""
        wanted: Document = {"limit": limit} | ({"robot": robot} if robot else {})
        return list(self._connection.get("/v1/jobs", **wanted)["jobs"])

    def get(self, job: str, robot: str | None = None) -> Document:
        """Return a job's document; the id may be its beginning, a name, or ``latest`` with its robot."""
        return self._connection.get(address("jobs", id_of(self._connection, "job", job, robot)))

    def cancel(self, job: str, robot: str | None = None) -> Document:
        """Ask a job to stop."""
        return self._connection.post(address("jobs", id_of(self._connection, "job", job, robot), "cancel"))

    def wait(
        self,
        job: str,
        progress: Progress | None = None,
        timeout_s: float | None = None,
        robot: str | None = None,
    ) -> Document:
        """Follow a job to its end and return its document with the result.

        Raises:
            JobFailedError: it failed; the document is the exception's ``job``.
            JobCancelledError: it was cancelled.
            JobTimeoutError: it goes on after ``timeout_s``.

        """
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        job_id = id_of(self._connection, "job", job, robot)
        for told in self._follow(job_id):
            if progress is not None:
                progress(*_progress_of(told))
            if told.get("state") in FINISHED:
                return succeeded(told if "result" in told else self.get(job_id))
            if deadline is not None and time.monotonic() > deadline:
                raise JobTimeoutError(
                    f"Job {job_id} is still {told.get('state')} after {timeout_s:g} s.", job_id=job_id
                )
        return succeeded(self.get(job_id))

    def run(
        self,
        kind: str,
        robot: str,
        campaigns: Sequence[str] = (),
        validation: Validation = None,
        options: Mapping[str, Any] | None = None,
        progress: Progress | None = None,
        timeout_s: float | None = None,
        confirmation: Sequence[str] = (),
        name: str = "",
    ) -> Document:
        """Submit a job and wait for it."""
        job = self.submit(kind, robot, campaigns, validation, options, confirmation, name)
        return self.wait(job["id"], progress, timeout_s)

    def _follow(self, job_id: str) -> Iterator[Document]:
        """Yield what the event stream tells; when it breaks or is refused, what the job's document says."""
        try:
            yield from self._events(job_id)
        except (ServerUnreachableError, ApiError) as error:
            if isinstance(error, NotFoundError | NotAuthorisedError):
                raise
        yield from self._polled(job_id)

    def _events(self, job_id: str) -> Iterator[Document]:
        with self._connection.lines(address("jobs", job_id, "events")) as lines:
            for data in event_data(lines):
                if isinstance(data, dict):
                    yield data

    def _polled(self, job_id: str) -> Iterator[Document]:
        looks, silences = 0, 0
        while True:
            try:
                job = self.get(job_id)
            except ServerUnreachableError:
                silences += 1
                if silences >= MAX_SILENCES:
                    raise
            else:
                silences = 0
                yield job
                if job.get("state") in FINISHED:
                    return
            time.sleep(POLL_S[min(looks, len(POLL_S) - 1)])
            looks += 1


def _request(
    kind: str,
    robot: str,
    campaigns: Sequence[str],
    validation: Validation,
    options: Mapping[str, Any] | None,
    confirmation: Sequence[str],
    name: str,
) -> Document:
    body: Document = {"kind": kind, "robot": robot, "campaigns": list(campaigns), "options": dict(options or {})}
    more = {"validation": validation, "confirmation": list(confirmation) or None, "name": name or None}
    return body | {key: value for key, value in more.items() if value is not None}


def event_data(lines: Iterator[str]) -> Iterator[Any]:
    """Yield the JSON of each server-sent event; comments are passed over, an event without JSON is None."""
    data: list[str] = []
    for line in lines:
        if line.startswith("data:"):
            data.append(line[5:].removeprefix(" "))
        elif not line and data:
            yield _json("\n".join(data))
            data = []


def _json(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return None


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


def _progress_of(job: Document) -> tuple[float, str]:
    progress = job.get("progress") or job
    return float(progress.get("fraction") or 0.0), str(progress.get("stage") or job.get("state") or "")
