"""What the routes share: the application's settings and database.

Dependencies are async: FastAPI gives every other one a thread, and a request would wait for it.
"""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Query, Request

from kilter_service.ground.db import Database
from kilter_service.ground.files.private_files import Scratch
from kilter_service.ground.paging import Page, decode_cursor
from kilter_service.ground.settings import Settings


async def get_database(request: Request) -> Database:
    """Return the database of the application that serves this request."""
    database: Database = request.app.state.database
    return database


async def get_settings(request: Request) -> Settings:
    """Return the settings of the application that serves this request."""
    settings: Settings = request.app.state.settings
    return settings


def get_scratch(request: Request) -> Scratch:
    """Return where the application that serves this request keeps temporary files."""
    scratch: Scratch = request.app.state.scratch
    return scratch


DatabaseOfApp = Annotated[Database, Depends(get_database)]
SettingsOfApp = Annotated[Settings, Depends(get_settings)]


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
