"""The two steps of every job: compute its outcome, store its outcome. Both may run again after a crash."""

from __future__ import annotations

import ctypes
import gc
import logging
import sys
import threading
import time
from dataclasses import asdict
from typing import Any

from kilter_core.errors import CancelledError, CoreError
from kilter_service.contract.versions import CorrectionLimits
from kilter_service.db import Database
from kilter_service.jobs import store
from kilter_service.jobs.default_load import with_load_warning
from kilter_service.jobs.kind import JobKind, VersionContent
from kilter_service.jobs.records import UsedRecord
from kilter_service.jobs.registry import kind_of
from kilter_service.observability import logs, tracing
from kilter_service.versions.objections import objections_of

log = logging.getLogger("kilter.worker")

Outcome = dict[str, Any]

REPORT_S = 0.2  # progress is stored, and cancellation looked for, at most this often
MAX_ATTEMPTS = 10  # a job that has crashed the worker this often would go on doing so


class Runner:
    """Runs one long job and one other at a time, however many the engine dispatches at once."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._slots = {long: threading.Lock() for long in (False, True)}

    def compute(self, job_id: str) -> Outcome:
        """First step: the outcome of a job, JSON-able; it is checkpointed and not computed again."""
        try:
            with self._database.reading() as session:
                job = store.get(session, job_id)
        except CoreError as error:
            return _failed(error.code, error.message)
        asked = job.asked
        with (
            logs.about(request_id=asked.request_id, job_id=job_id, robot=job.robot),
            tracing.job(job.kind, job_id, job.robot, asked.traceparent),
        ):
            began = time.monotonic()
            outcome = self._outcome(job_id)
            log.info("%s %s after %.1f s", job.kind, outcome["state"], time.monotonic() - began)
            return outcome

    def _outcome(self, job_id: str) -> Outcome:
        report = ProgressReporter(self._database, job_id)
        try:
            slot = self._slots[self._kind(job_id).long]
            while not slot.acquire(timeout=REPORT_S):
                report(0.0, "waiting for another job")
            try:
                return self._compute(job_id, report)
            finally:
                slot.release()
                give_back()
        except CancelledError:
            return {"state": "cancelled"}
        except CoreError as error:
            return _failed(error.code, error.message)
        except Exception:
            log.exception("job %s failed", job_id)
            return _failed("internal_error", f"Kilter failed. The worker's log has the cause under job {job_id}.")

    def _kind(self, job_id: str) -> JobKind:
        with self._database.reading() as session:
            return kind_of(store.get(session, job_id).kind)

    def _compute(self, job_id: str, report: ProgressReporter) -> Outcome:
        kind = self._kind(job_id)
        with self._database.transaction() as session:
            attempt = store.begin(session, job_id)
        if attempt == 0:
            return {"state": "over"}
        if attempt > MAX_ATTEMPTS:
            return _failed("internal_error", f"The worker died {MAX_ATTEMPTS} times in this job: see its log.")
        report(0.0, "loading", now=True)
        with self._database.reading() as session:
            job, used = store.load(session, job_id), store.used_by(session, job_id)
        output = with_load_warning(kind.run(job, report), job)
        report(1.0, "storing", now=True)
        version = None if output.version is None else _as_document(output.version)
        return {
            "state": "succeeded",
            "result": output.result,
            "version": version,
            "used": [asdict(one) for one in used],
        }

    def finish(self, job_id: str, outcome: Outcome) -> None:
        """Second step: store the outcome; a second time changes nothing."""
        with self._database.transaction() as session:
            if outcome["state"] == "succeeded":
                version = _as_content(outcome["version"])
                said = [] if version is None else objections_of(version.report, version.limits)
                used = outcome.get("used")
                records = None if used is None else [UsedRecord(**one) for one in used]
                store.succeed(session, job_id, outcome["result"], version, records, said)
            elif outcome["state"] == "failed":
                store.fail(session, job_id, outcome["code"], outcome["message"])
            elif outcome["state"] == "cancelled":
                store.cancel(session, job_id)


class ProgressReporter:
    """The progress callback of one job."""

    def __init__(self, database: Database, job_id: str) -> None:
        self._database = database
        self._job_id = job_id
        self._next = 0.0

    def __call__(self, fraction: float, stage: str, *, now: bool = False) -> None:
        """Store the progress.

        Raises:
            CancelledError: the job was cancelled.

        """
        time_s = time.monotonic()
        if time_s < self._next and not now:
            return
        self._next = time_s + REPORT_S
        with self._database.transaction() as session:
            stop = store.advance(session, self._job_id, fraction, stage)
        if stop:
            raise CancelledError(f"Job {self._job_id} was cancelled.")


def give_back() -> None:
    """Give the memory of a job that is over back to the system: the C library would keep it for the next one."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(0)


def _failed(code: str, message: str) -> Outcome:
    return {"state": "failed", "code": code, "message": message}


def _as_document(content: VersionContent) -> dict[str, Any]:
    fields = {key: value for key, value in asdict(content).items() if key != "limits"}
    return {**fields, "limits": content.limits.model_dump(mode="json")}


def _as_content(document: dict[str, Any] | None) -> VersionContent | None:
    if document is None:
        return None
    return VersionContent(**{**document, "limits": CorrectionLimits(**document["limits"])})
