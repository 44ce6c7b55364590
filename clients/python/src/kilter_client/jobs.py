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
# How long a wait goes on without an answer: a server that is started again is ready within seconds, on a busy machine
# that compiles its kernels within a minute or two.
PATIENCE_S = 120.0
LOOK_TIMEOUT_S = 10.0
AWAY = f"the server does not answer, waiting up to {PATIENCE_S:.0f} s for it"


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
        """Follow a job to its end and return its document with the result, through a restart of the server too.

        Raises:
            JobFailedError: it failed; the document is the exception's ``job``.
            JobCancelledError: it was cancelled.
            JobTimeoutError: it goes on after ``timeout_s``.
            ServerUnreachableError: the server gave no answer for two minutes; the job is stored there.

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
                    f"Job {job_id} is still {told.get('state', 'without an answer')} after {timeout_s:g} s.",
                    job_id=job_id,
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
        """Yield the job's document again and again, through a restart of the server that ends within ``PATIENCE_S``."""
        looks, heard, job = 0, time.monotonic(), Document()
        while job.get("state") not in FINISHED:
            try:
                job = self._look(job_id)
                heard = time.monotonic()
                yield job
            except (ServerUnreachableError, ApiError) as error:
                if not _may_pass(error):
                    raise
                if time.monotonic() - heard > PATIENCE_S:
                    raise _gone(self._connection.url, job_id) from error
                self._connection.look_again()
                yield {"progress": {"fraction": _progress_of(job)[0], "stage": AWAY}}
            time.sleep(POLL_S[min(looks, len(POLL_S) - 1)])
            looks += 1

    def _look(self, job_id: str) -> Document:
        path = address("jobs", job_id)
        return self._connection.document(self._connection.request("GET", path, timeout=LOOK_TIMEOUT_S))


def _may_pass(error: ServerUnreachableError | ApiError) -> bool:
    """Whether an error is one of a server that starts, stops or is busy, so that asking again may help."""
    return isinstance(error, ServerUnreachableError) or (error.status or 0) >= 500


def _gone(url: str, job_id: str) -> ServerUnreachableError:
    return ServerUnreachableError(
        f"{url} has not answered for {PATIENCE_S:.0f} s. Job {job_id} is stored there and goes on when the server is back: "
        f"`kilter jobs watch {job_id}` follows it.",
        url=url,
        job_id=job_id,
    )


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
