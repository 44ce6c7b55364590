"""The seal of a passed check: Run is refused unless the check passed for exactly these inputs.

The seal is a keyed hash of the job as it was checked and of its campaigns as they were then. Nothing is stored: Run
computes it anew, so it fits no other input and no campaign that has changed since.
"""

from __future__ import annotations

import hashlib
import hmac
import json

from kilter_service.campaigns import service as campaigns
from kilter_service.contract.jobs.registry import NewJob
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError


def compute_job_seal(database: Database, key: str, job: NewJob) -> str:
    """Return the seal of a job and its campaigns as they are now."""
    held = job.validation if isinstance(job.validation, list) else []
    used = [*job.campaigns, *held, *job.confirmation]
    state = [campaigns.get(database, campaign).model_dump(mode="json") for campaign in used]
    text = json.dumps([job.model_dump(mode="json"), state], sort_keys=True)
    return hmac.new(key.encode(), b"check of a job\n" + text.encode(), hashlib.sha256).hexdigest()


def demand(database: Database, key: str, job: NewJob, given: str) -> None:
    """Refuse a job that was not checked as it is.

    Raises:
        ServiceError: no check passed for these inputs, or a campaign has changed since.

    """
    if not hmac.compare_digest(compute_job_seal(database, key, job).encode(), given.encode()):
        raise ServiceError(
            "No check has passed for exactly these inputs, or a campaign has changed since: press Check, then Run.",
            code="option_invalid",
        )
