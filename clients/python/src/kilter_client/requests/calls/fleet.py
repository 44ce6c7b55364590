"""Calls about fleet jobs: many robots identified anew by one request."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from kilter_client.requests.calls.jobs import Progress, Watch, poll_until_finished
from kilter_client.requests.steps import Document, Request, Steps, address, get, idempotency_header, post, read

PLACE = "fleet-jobs"
SUBMIT_TIMEOUT_S = 300.0  # a thousand robots are looked at before the answer
FOLLOW = "kilter robot fleet watch"


def identify_fleet(
    robots: Sequence[str] | None = None,
    *,
    campaigns: Mapping[str, Sequence[str]] | None = None,
    validation: float | None = None,
    options: Mapping[str, Any] | None = None,
    name: str = "",
) -> Steps[Document]:
    """Identify many robots anew, each by a job of its own; returns the fleet job, still queued. Nothing is activated.

    Args:
        robots: names of the robots; None: all that are in use.
        campaigns: ids of the campaigns to use, by robot. Of a robot that is not named: those that its active version was
            made from and what was measured since.
        validation: fraction of the poses that is held out where nobody measured for validation; None: 0.2.
        options: options of all identifications; None: for each robot those of its active version.
        name: name of the fleet job, its jobs and the versions they make.

    Raises:
        NotFoundError: a robot that does not exist.

    """
    body: Document = {"robots": None if robots is None else [*robots], "name": name}
    body |= {"campaigns": {robot: [*ids] for robot, ids in (campaigns or {}).items()}}
    body |= {} if validation is None else {"validation": validation}
    body |= {} if options is None else {"options": dict(options)}
    request = Request("POST", f"/v1/{PLACE}", body=body, headers=idempotency_header(), timeout_s=SUBMIT_TIMEOUT_S)
    return read(request)


def fleet_jobs(limit: int = 100) -> Steps[list[Document]]:
    """Return the newest fleet jobs, without the rows of their robots."""
    found = yield from get(f"/v1/{PLACE}", limit=limit)
    return list(found["fleet_jobs"])


def fleet_job(fleet_job: str) -> Steps[Document]:
    """Return a fleet job; its ``report`` has a row for each robot: version, errors before and after, or why there is none.

    Raises:
        NotFoundError: there is none.

    """
    return get(address(PLACE, fleet_job))


def wait_for_fleet(
    fleet_job: str, *, progress: Progress | None = None, timeout_s: float | None = None
) -> Steps[Document]:
    """Follow a fleet job until all its jobs are over, and return it, however they ended.

    Raises:
        JobTimeoutError: it goes on after ``timeout_s``.
        ServerUnreachableError: the server gave no answer for two minutes; the jobs are stored there.

    """
    watch = Watch(fleet_job, progress, timeout_s, FOLLOW)
    yield from poll_until_finished(address(PLACE, fleet_job), watch)
    return watch.last


def cancel_fleet(fleet_job: str) -> Steps[Document]:
    """Cancel the jobs of a fleet job that are not over; versions that were made stay.

    Raises:
        NotFoundError: there is none. ConflictError: all are over.

    """
    return post(address(PLACE, fleet_job, "cancel"))
