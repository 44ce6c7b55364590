"""The job engine as the API sees it: queue a job, look it up, cancel it."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING

from kilter_service.jobs.engine_clock import keep_time
from kilter_service.jobs.engine_rows import json_only
from kilter_service.settings import Settings

if TYPE_CHECKING:
    from dbos import DBOSClient

APPLICATION = "kilter"
QUEUE, LONG_QUEUE = "jobs", "long-jobs"  # one job of each runs at a time
WORKFLOW = "kilter.job"
# DBOS resumes only jobs of its own application version. This names the shape of the workflow (its steps and what they
# hand on), not the build: change it when that shape changes. `forget_older` then lets older jobs be restarted.
APPLICATION_VERSION = "kilter-jobs-2"
UNFINISHED = ["DELAYED", "ENQUEUED", "PENDING"]


@dataclass(frozen=True)
class EngineRow:
    """What DBOS knows of a job: its status, whether the row asks for this very job in JSON, and why it failed."""

    status: str
    readable: bool
    error: str | None


class JobQueue:
    """A connection to DBOS's system database, opened when it is first needed."""

    def __init__(self, settings: Settings) -> None:
        self._url = settings.jobs_database
        self._lock = threading.Lock()
        self._client: DBOSClient | None = None

    def enqueue(self, job_id: str, *, long: bool = False) -> None:
        """Queue a job, a ``long`` one beside the others; queueing it a repeat changes nothing."""
        self._open().enqueue(
            {
                "workflow_name": WORKFLOW,
                "queue_name": LONG_QUEUE if long else QUEUE,
                "workflow_id": job_id,
                "app_version": APPLICATION_VERSION,
            },
            job_id,
        )

    def cancel(self, job_id: str) -> None:
        """Take a job out of the queue; a running one notices at its next progress report."""
        self._open().cancel_workflow(job_id)

    def row(self, job_id: str) -> EngineRow | None:
        """Return what DBOS knows of a job, None when it does not know it."""
        found = self._open().list_workflows(workflow_ids=[job_id])
        if not found:
            return None
        # DBOS gives the raw text of inputs that it cannot read.
        asked = found[0].input
        readable = isinstance(asked, dict) and list(asked.get("args") or ()) == [job_id] and not asked.get("kwargs")
        error = found[0].error
        return EngineRow(found[0].status, readable, None if error is None else str(error))

    def forget(self, job_id: str) -> None:
        """Take a job's row out of DBOS's database, with all its steps."""
        self._open().delete_workflow(job_id)

    def forget_older(self) -> list[str]:
        """Take out the jobs of other application versions, which nobody would resume; returns their ids."""
        rows = self._open().list_workflows(name=WORKFLOW, status=UNFINISHED, load_input=False, load_output=False)
        older = [row.workflow_id for row in rows if row.app_version != APPLICATION_VERSION]
        if older:
            self._open().delete_workflows(older)
        return older

    def close(self) -> None:
        """Close the connection."""
        with self._lock:
            if self._client is not None:
                self._client.destroy()
                self._client = None

    def _open(self) -> DBOSClient:
        with self._lock:
            if self._client is None:
                from dbos import DBOSClient  # a second of import: not at the start of the API process

                keep_time()
                self._client = DBOSClient(
                    system_database_url=self._url,
                    application_name=APPLICATION,
                    retry_connection_errors=False,
                    serializer=json_only(),
                )
            return self._client
