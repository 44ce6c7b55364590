"""A token that is limited to robots: what a path names must be of one of them, before the body is read.

Stores leave out what the caller may not see (`kilter_service.caller`), so everything else is as unknown to such a token as
what does not exist: 404.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from kilter_service.campaigns import store as campaigns
from kilter_service.db import Database, Session
from kilter_service.jobs import store as jobs
from kilter_service.jobs.fleet import store as fleet_jobs
from kilter_service.references.store import NOMINAL
from kilter_service.robots import store as robots
from kilter_service.versions import store as versions

LOOKED_UP: Mapping[str, Callable[[Session, str], Any]] = {
    "robot": robots.get,
    "campaign": campaigns.get,
    "version": versions.get,
    "a": versions.get,
    "b": versions.get,
    "job": jobs.get,
    "fleet_job": fleet_jobs.get,
}


def check_path(database: Database, named: Mapping[str, Any]) -> None:
    """Look up what a path names.

    Raises:
        ServiceError: it does not exist, or the caller may not see it.

    """
    with database.reading() as session:
        for name, value in named.items():
            if name in LOOKED_UP and value != NOMINAL:
                LOOKED_UP[name](session, str(value))
