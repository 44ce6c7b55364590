"""What is found by words: each must be in the name, or in that of its robot."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from kilter_service.campaigns import service as campaigns
from kilter_service.ground.called import display_name
from kilter_service.ground.db import Database
from kilter_service.ground.paging import Page
from kilter_service.jobs import service as jobs
from kilter_service.robots import service as robots
from kilter_service.versions import service as versions

MOST, MOST_ROBOTS, EACH = 12, 4, 100  # found, robots that are looked into, and things of each
VIEWS = {
    "overview": "",
    "campaigns": "/campaigns",
    "new campaign": "/campaigns/new",
    "identify and search": "/jobs",
    "versions": "/versions",
    "correct a path": "/correct",
    "stream": "/stream",
    "settings": "/settings",
}
EVERYWHERE = {"all robots": "/", "all jobs": "/jobs", "new robot": "/new-robot"}


@dataclass(frozen=True)
class Place:
    """Something to go to: its name, what it is, and its address."""

    name: str
    kind: str
    address: str


def find(database: Database, sought: str, robot: str) -> list[Place]:
    """Return the first places that fit, those of the robot that is looked at before others."""
    words = sought.casefold().split()
    fitting = (one for one in _places(database, words, robot) if all(word in one.name.casefold() for word in words))
    return [one for one, _ in zip(fitting, range(MOST), strict=False)]


def _places(database: Database, words: list[str], here: str) -> Iterator[Place]:
    names = [one.name for one in robots.list_robots(database, Page()).robots]
    named = [name for name in names if name == here or not words or any(word in name.casefold() for word in words)]
    named.sort(key=lambda name: name != here)
    yield from (Place(name, "robot", f"/robots/{name}") for name in named)
    yield from (Place(name, "view", address) for name, address in EVERYWHERE.items())
    for name in named[:MOST_ROBOTS]:
        yield from (Place(f"{name} {view}", "view", f"/robots/{name}{end}") for view, end in VIEWS.items())
        for version in versions.list_versions(database, name, Page(limit=EACH)).versions:
            yield Place(f"{name} {display_name(version)}", "version", f"/versions/{version.id}")
        for campaign in campaigns.list_campaigns(database, name, Page()).campaigns[-EACH:]:
            yield Place(f"{name} {campaign.name}", "campaign", f"/campaigns/{campaign.id}")
        for job in jobs.list_jobs(database, name, Page(limit=EACH)).jobs:
            yield Place(f"{name} {display_name(job)}", "job", f"/jobs/{job.id}")
