"""What people call a version."""

from __future__ import annotations

from kilter_service.ground.called import display_name
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.versions import service as versions


def version_name(database: Database, version: str | None) -> str:
    """Return the name of a version, what it is where it has none, its id where it is gone; empty: the nominal robot."""
    if not version:
        return ""
    try:
        return display_name(versions.get(database, version))
    except ServiceError:
        return version
