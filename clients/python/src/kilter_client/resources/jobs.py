"""Jobs: submit one, follow it, read its result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from kilter_client.requests.calls import jobs
from kilter_client.requests.calls.jobs import Progress, require_success
from kilter_client.requests.methods import make_document_method
from kilter_client.requests.steps import Document, event_data
from kilter_client.resources.references import Resource

__all__ = ["Jobs", "Progress", "Validation", "event_data", "require_success"]

Validation = Sequence[str] | float | Mapping[str, int] | None


class Jobs(Resource):
    """The jobs of a server."""

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

        ``confirmation`` are campaigns of another day or set-up in which a gap search must see again what it found.
        Campaigns and versions may be named by the beginning of an id, a name, or ``latest``. ``name`` is that of the job
        and of the version it makes.
        """
        body = jobs.request_body(kind, robot, campaigns, validation, options, confirmation, name)
        return self._run(jobs.submit(robot, body))

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
        body = jobs.request_body(kind, robot, campaigns, validation, options, confirmation, name)
        return self._run(jobs.check(robot, body))

    list = make_document_method(jobs.list_jobs)
    get = make_document_method(jobs.fetch_document)
    cancel = make_document_method(jobs.cancel)

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
        return self._run(jobs.wait(job, progress, timeout_s, robot))

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
