"""What people call a version."""

from __future__ import annotations

from kilter_service.ground.called import called
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.versions import service as versions


def name_of(database: Database, version: str | None) -> str:
    """Return the name of a version, what it is where it has none, its id where it is gone; empty: the nominal robot."""
    if not version:
        return ""
    try:
        return called(versions.get(database, version))
    except ServiceError:
        return version
