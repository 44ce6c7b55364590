"""Long lists: what of one is shown, by what the address says. Nothing ends without a word: what is left out is counted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any, Generic, TypeVar
from urllib.parse import urlencode

from fastapi import Request

from kilter_service.contract.jobs.kind import JobSummary
from kilter_service.contract.jobs.registry import KINDS as DECLARED
from kilter_service.ground.db import Database
from kilter_service.ground.paging import Page
from kilter_service.jobs import service as jobs
from kilter_service.jobs.records import Place, WantedJobs

T = TypeVar("T")
AT_ONCE = 50
LONGEST = 200  # characters of a search
SEARCH, SORT, PAGE = "search", "sort", "page"


@dataclass(frozen=True)
class Asked:
    """What the address asks of a list: a text to find, ``filters`` by name, the column to sort by (``-`` before it: the
    largest first), and the page, from 1.
    """

    search: str = ""
    sort: str = ""
    page: int = 1
    filters: Mapping[str, str] = field(default_factory=dict)

    @staticmethod
    def from_request(request: Request, filters: Sequence[str] = (), page: str = PAGE) -> Asked:
        """Read an address; what makes no sense asks for nothing."""
        given = request.query_params
        number = given.get(page, "")
        return Asked(
            given.get(SEARCH, "").strip()[:LONGEST],
            given.get(SORT, "")[:LONGEST],
            max(int(number), 1) if number.isascii() and number.isdigit() and len(number) < 10 else 1,
            {name: value for name in filters if (value := given.get(name, "").strip()[:LONGEST])},
        )

    def query(self, page: str = PAGE) -> str:
        """Write it as the query of an address; what is as usual is left out."""
        told = {SEARCH: self.search, SORT: self.sort, **self.filters, page: str(self.page) if self.page > 1 else ""}
        return urlencode({name: value for name, value in told.items() if value})


@dataclass(frozen=True)
class Part(Generic[T]):
    """A page of a list: what is shown of what was found, ``found`` of all ``total``."""

    shown: Sequence[T]
    found: int
    total: int
    asked: Asked
    usual: str = ""  # the column that sorts it where none is asked for
    named: str = PAGE

    @property
    def first(self) -> int:
        """Place of the first entry that is shown, from 1."""
        return (self.asked.page - 1) * AT_ONCE + 1

    @property
    def last(self) -> int:
        """Place of the last one."""
        return self.first + len(self.shown) - 1

    @property
    def before(self) -> str | None:
        """The query of the page before; None on the first."""
        return self._page(self.asked.page - 1) if self.asked.page > 1 else None

    @property
    def after(self) -> str | None:
        """The query of the next page; None on the last."""
        return self._page(self.asked.page + 1) if self.last < self.found else None

    def _page(self, number: int) -> str:
        return replace(self.asked, page=number).query(self.named)

    def order(self, column: str) -> str:
        """How a column sorts the list now, as ``aria-sort`` has it; empty: it does not."""
        by = self.asked.sort or self.usual
        return {column: "ascending", f"-{column}": "descending"}.get(by, "")

    def sorted_by(self, column: str) -> str:
        """The query that sorts by a column, the other way round where it does already."""
        turned = f"-{column}" if self.order(column) == "ascending" else column
        return replace(self.asked, sort=turned, page=1).query(self.named)


def select_page(
    entries: Sequence[T],
    asked: Asked,
    words: Callable[[T], str],
    columns: Mapping[str, Callable[[T], Any]],
    filters: Mapping[str, Callable[[T], str]] | None = None,
    usual: str = "",
    named: str = PAGE,
) -> Part[T]:
    """Return the page of a list that is asked for.

    ``words`` are what a search looks in, ``columns`` what sorts, ``filters`` the value of an entry that a filter asks for.
    """
    sought = asked.search.casefold().split()
    wanted = [(filters[name], value) for name, value in asked.filters.items() if name in filters] if filters else []
    kept = [one for one in entries if all(value == read(one) for read, value in wanted)]
    kept = [one for one in kept if all(word in words(one).casefold() for word in sought)] if sought else kept
    by = asked.sort if asked.sort.removeprefix("-") in columns else usual
    if by:
        key = columns[by.removeprefix("-")]
        known, unknown = [one for one in kept if key(one) is not None], [one for one in kept if key(one) is None]
        kept = [*sorted(known, key=lambda one: _comparable(key(one)), reverse=by.startswith("-")), *unknown]
    last = max(-(-len(kept) // AT_ONCE), 1)
    at = min(asked.page, last)
    shown = kept[(at - 1) * AT_ONCE : at * AT_ONCE]
    return Part(shown, len(kept), len(entries), replace(asked, page=at), usual, named)


def _comparable(value: Any) -> Any:
    if isinstance(value, str):
        return value.casefold()
    return value.timestamp() if isinstance(value, datetime) else value


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
    words = [
        (one, [kind for kind, title in KINDS.items() if one.casefold() in title.casefold()])
        for one in wanted.search.split()
    ]
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


def page_of_jobs(database: Database, robot: str | None, page: Page) -> Listed:
    """Return a page of jobs, of one robot or of all that may be seen."""
    found = jobs.list_jobs(database, robot, page)
    return Listed(found.jobs, jobs.places(database), found.next)
