"""The job engine as seen from outside: put a job in its queue, ask after it, cancel it."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

from service.settings import Settings

if TYPE_CHECKING:
    from dbos import DBOSClient

APPLICATION = "kilter"
QUEUE = "jobs"
WORKFLOW = "kilter.job"
# DBOS resumes only jobs of its own application version. This names the shape of the workflow (its steps and what they
# hand on), not the build: change it when that shape changes, and older jobs are started anew by `reconcile`.
APPLICATION_VERSION = "kilter-jobs-1"


class JobQueue:
    """A connection to DBOS's system database, opened when it is first needed."""

    def __init__(self, settings: Settings) -> None:
        self._url = settings.jobs_database
        self._lock = threading.Lock()
        self._client: DBOSClient | None = None

    def enqueue(self, job_id: str) -> None:
        """Queue a job; queueing it again changes nothing."""
        self._open().enqueue(
            {
                "workflow_name": WORKFLOW,
                "queue_name": QUEUE,
                "workflow_id": job_id,
                "app_version": APPLICATION_VERSION,
            },
            job_id,
        )

    def cancel(self, job_id: str) -> None:
        """Take a job out of the queue; one that runs is told by its progress callback."""
        self._open().cancel_workflow(job_id)

    def status(self, job_id: str) -> str | None:
        """Return DBOS's word on a job, None when it does not know it."""
        found = self._open().list_workflows(workflow_ids=[job_id], load_input=False, load_output=False)
        return found[0].status if found else None

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

                self._client = DBOSClient(
                    system_database_url=self._url, application_name=APPLICATION, retry_connection_errors=False
                )
            return self._client
