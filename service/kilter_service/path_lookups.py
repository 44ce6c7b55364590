"""How what a path names is looked up, for tokens that are limited to robots."""

from __future__ import annotations

from kilter_service.auth.scope import Lookup, Lookups
from kilter_service.campaigns import store as campaigns
from kilter_service.db import Session
from kilter_service.jobs import store as jobs
from kilter_service.jobs.fleet import store as fleet_jobs
from kilter_service.references.store import NOMINAL
from kilter_service.robots import store as robots
from kilter_service.versions import store as versions


def _unless_nominal(lookup: Lookup) -> Lookup:
    def look_up(session: Session, value: str) -> object:
        return None if value == NOMINAL else lookup(session, value)

    return look_up


LOOKUPS: Lookups = {
    name: _unless_nominal(lookup)
    for name, lookup in {
        "robot": robots.get,
        "campaign": campaigns.get,
        "version": versions.get,
        "a": versions.get,
        "b": versions.get,
        "job": jobs.get,
        "fleet_job": fleet_jobs.get,
    }.items()
}
