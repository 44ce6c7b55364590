"""Jobs in lists: of the whole server, or of a robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from kilter_service.contract.jobs.job import JobSummary
from kilter_service.contract.jobs.registry import KINDS as DECLARED
from kilter_service.ground.db import Database
from kilter_service.ground.paging import Page
from kilter_service.jobs import service as jobs
from kilter_service.jobs.records import Place, WantedJobs
from kilter_service.page.shared.lists import AT_ONCE, Asked, Part

KINDS: Mapping[str, str] = {name: kind.title for name, kind in DECLARED.items()}


@dataclass(frozen=True)
class Listed:
    """Jobs, newest first; where those stand that are not over; and the cursor of older ones."""

    jobs: Sequence[JobSummary]
    places: Mapping[str, Place]
    more: str | None

    @property
    def kinds(self) -> Mapping[str, str]:
        """What the kinds of jobs are called."""
        return KINDS

    @property
    def searches(self) -> int:
        """How many of these jobs are searches that can be compared."""
        return sum(job.kind == "gap" and job.state == "succeeded" for job in self.jobs)


STATES = ("queued", "running", "succeeded", "failed", "cancelled")


ORDERS = ("name", "robot", "kind", "state", "asked")


def select_jobs(database: Database, robot: str | None, wanted: Asked) -> tuple[Listed, Part[JobSummary]]:
    """Return the jobs that the address asks for, of one robot or of all that may be seen; the database counts and sorts."""
    by = wanted.sort if wanted.sort.removeprefix("-") in ORDERS else "-asked"
    words = [(one, _kinds_matching_word(one)) for one in wanted.search.split()]
    sought = WantedJobs(
        robot,
        wanted.filters.get("kind"),
        wanted.filters.get("state"),
        words,
        by.removeprefix("-"),
        by.startswith("-"),
        sorted(KINDS, key=lambda kind: KINDS[kind].casefold()),
        STATES,
    )
    shown, page, found, total = jobs.find_jobs(database, sought, wanted.page, AT_ONCE)
    return Listed(shown, jobs.places(database), None), Part(shown, found, total, replace(wanted, page=page), "-asked")


def _kinds_matching_word(word: str) -> list[str]:
    """Kinds of jobs in whose words a word is."""
    return [kind for kind, words in KINDS.items() if word.casefold() in words.casefold()]


def page_of_jobs(database: Database, robot: str | None, page: Page) -> Listed:
    """Return a page of jobs, of one robot or of all that may be seen."""
    found = jobs.list_jobs(database, robot, page)
    return Listed(found.jobs, jobs.places(database), found.next)
