"""What the routes share: the application's settings and database.

Dependencies are async: FastAPI gives every other one a thread, and a request would wait for it.
"""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Request

from kilter_service.ground.db import Database
from kilter_service.ground.files.private_files import Scratch
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
