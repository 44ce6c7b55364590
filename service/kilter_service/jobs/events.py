"""The life of a job as server-sent events."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

from fastapi.concurrency import run_in_threadpool

from kilter_service.contract.jobs.job import FINAL, Job
from kilter_service.db import Database
from kilter_service.jobs import service

POLL_S = 0.2
ALIVE_S = 10.0


async def events(database: Database, job_id: str) -> AsyncIterator[str]:
    """Yield an event ``progress`` at every change and ``end`` with the whole job when it is over."""
    last, number, silent = "", 0, 0.0
    while True:
        job = await run_in_threadpool(service.get, database, job_id)
        if job.state in FINAL:
            yield _event("end", number, job.model_dump_json())
            return
        data = _progress(job)
        if data != last:
            yield _event("progress", number, data)
            last, number, silent = data, number + 1, 0.0
        elif silent >= ALIVE_S:
            yield ": still here\n\n"
            silent = 0.0
        await asyncio.sleep(POLL_S)
        silent += POLL_S


def _progress(job: Job) -> str:
    return job.model_dump_json(include={"id", "state", "progress"})


def _event(name: str, number: int, data: str) -> str:
    return f"id: {number}\nevent: {name}\ndata: {data}\n\n"
