"""A worker's right to one run of a job. It ends when the job is put back, cancelled or over; then nothing more is stored."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Claim:
    """One run of a job: whoever claims the job next has another attempt."""

    job_id: str
    worker: str
    attempt: int
