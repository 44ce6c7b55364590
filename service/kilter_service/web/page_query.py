"""Which page of a list a request asks for."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Query

from kilter_service.ground.paging import Page, decode_cursor

MOST = 1000
JOBS = 100  # newest jobs that are listed by default

Limit = Annotated[int | None, Query(ge=1, le=MOST, description="Entries of a page, 1 to 1000; left out: all.")]
JobsLimit = Annotated[int, Query(ge=1, le=MOST, description="Jobs of a page, 1 to 1000.")]
After = Annotated[str | None, Query(max_length=400, description="`next` of the page before; left out: the first page.")]


async def page(limit: Limit = None, after: After = None) -> Page:
    """Read which page of a list is asked for."""
    return Page(limit, None if after is None else decode_cursor(after))


async def page_of_jobs(limit: JobsLimit = JOBS, after: After = None) -> Page:
    """Read which page of the jobs is asked for."""
    return Page(limit, None if after is None else decode_cursor(after))


PageOfList = Annotated[Page, Depends(page)]
PageOfJobs = Annotated[Page, Depends(page_of_jobs)]
