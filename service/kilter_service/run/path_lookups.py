"""How what a path names is looked up, for tokens that are limited to robots."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from kilter_service.campaigns import store as campaigns
from kilter_service.ground.db import Session
from kilter_service.ground.store import NOMINAL
from kilter_service.jobs import store as jobs
from kilter_service.jobs.fleet import store as fleet_jobs
from kilter_service.robots import store as robots
from kilter_service.versions import store as versions

LOOKED_UP: Mapping[str, Callable[[Session, str], object]] = {
    "robot": robots.get,
    "campaign": campaigns.get,
    "version": versions.get,
    "a": versions.get,
    "b": versions.get,
    "job": jobs.get,
    "fleet_job": fleet_jobs.get,
}


def look_up(session: Session, name: str, value: str) -> None:
    """Look up what a path calls ``name``; what has no robot of its own is passed over, as is `nominal`.

    Raises:
        ServiceError: it does not exist, or the caller may not see it.

    """
    if name in LOOKED_UP and value != NOMINAL:
        LOOKED_UP[name](session, value)
