"""All robots of the server, the worst first; what the palette finds; and the jobs of all robots."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import Query, Request, Response
from fastapi.responses import HTMLResponse
from markupsafe import Markup

from kilter_service.campaigns import service as campaigns
from kilter_service.contract.robot_reports import RobotSummary
from kilter_service.contract.today import NextStep, Today
from kilter_service.contract.versions import VersionSummary
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import display_name
from kilter_service.ground.paging import Page
from kilter_service.ground.settings import Settings
from kilter_service.jobs import service as jobs
from kilter_service.page.answers import redirect, render, router
from kilter_service.page.figures import drawn as strip
from kilter_service.page.figures.plot import Axis, lengths
from kilter_service.page.shared import lists as listed_jobs
from kilter_service.page.shared.lists import Asked, Part, select_page
from kilter_service.page.shared.standing import (
    LOUDNESS,
    Accuracy,
    Correcting,
    State,
    accuracy_today,
    assess_robot_state,
    corrector,
)
from kilter_service.page.words import format_in_largest_unit
from kilter_service.robots import service as robots
from kilter_service.versions import service as versions
from kilter_service.versions.drift import service as drift
from kilter_service.versions.predictions.differences import resolve_version_id
from kilter_service.versions.today import service as today
from kilter_service.web.routing import DatabaseOfApp, SettingsOfApp

DAY = 86400.0
COUNTS = {"bad": "to act on", "warn": "to look at", "faint": "not known", "good": "good"}


@dataclass(frozen=True)
class Row:
    """A robot with the version that corrects it, None without one, and the number of its jobs that are not over."""

    robot: RobotSummary
    version: VersionSummary | None
    today: Today
    accuracy: Accuracy | None
    correcting: Correcting
    open_jobs: int
    activated: Sequence[datetime]

    @property
    def state(self) -> State:
        """How the robot stands, as its own view says it."""
        return assess_robot_state(self.today, self.correcting)

    @property
    def step(self) -> NextStep | None:
        """What to do next."""
        steps = self.today.standing.steps if self.today.standing else []
        return steps[0] if steps else None

    @property
    def measured_at(self) -> datetime | None:
        """When the rows of the error were measured."""
        newest = self.today.newest
        return max((one.measured_at for one in newest.campaigns), default=newest.at) if newest else None

    @property
    def rank(self) -> tuple[int, float]:
        """The loudest first, then the least accurate."""
        return LOUDNESS.index(self.state.look), -self.accuracy.mean if self.accuracy else -math.inf

    @property
    def spark(self) -> Markup | str:
        """The last errors as a line; empty where there are fewer than two."""
        errors = self.today.history
        if len(errors) < 2:
            return ""
        first, last = (format_in_largest_unit(one.mean_mm, errors[-1].mean_mm) for one in (errors[0], errors[-1]))
        title = f"The last {len(errors)} errors: from {first} to {last}"
        days = [one.at.timestamp() / DAY for one in errors]
        marks = [one.timestamp() / DAY for one in self.activated]
        return strip.spark(days, [one.mean_mm for one in errors], marks, title)


def fleet(database: Database, settings: Settings, asked: Asked) -> dict[str, Any]:
    """Return the robots in use that the address asks for, worst first, how many there are of each look, and the shared axis."""
    seen = corrector(database, settings)
    open_jobs, active = jobs.open_of_robots(database), versions.active_of_robots(database)
    known, log = today.of_robots(database), drift.activations_of_robots(database)
    rows = []
    for robot in robots.list_robots(database, Page()).robots:
        now = known[robot.name]
        correcting = seen.describe_correction(robot.name, robot.active_version, robot.controller_compensation)
        many, accuracy = open_jobs.get(robot.name, 0), accuracy_today(now)
        rows.append(Row(robot, active.get(robot.name), now, accuracy, correcting, many, log.get(robot.name, ())))
    rows.sort(key=lambda row: row.rank)
    found = [row.accuracy for row in rows if row.accuracy is not None]
    limits = [row.robot.tolerance_mm for row in rows if row.robot.tolerance_mm is not None]
    shown = [end for one in found for end in (one.low or one.mean, one.high or one.mean)] + limits
    axis, most = lengths("mean error", shown, log=True), max((one.mean for one in found), default=1.0)
    return {
        "part": select_rows(rows, asked),
        "counts": {look: sum(row.state.look == look for row in rows) for look in COUNTS},
        "ruler": strip.ruler(axis),
        "most": most,
        "drawn": lambda row: _draw_error(row, axis, most),
    }


def _draw_error(row: Row, axis: Axis, most: float) -> Markup | str:
    """The error of a row on the shared axis."""
    found, standing = row.accuracy, row.today.standing
    if found is None or standing is None:
        return ""
    low, high = found.low or found.mean, found.high or found.mean
    title = f"Mean error {format_in_largest_unit(found.mean, most)}"
    return strip.error(axis, found.mean, low, high, standing.tolerance_mm, row.state.look, title)


def select_rows(rows: list[Row], asked: Asked) -> Part[Row]:
    """Return the rows that the address asks for; without a column they stay worst first."""
    return select_page(
        rows,
        asked,
        lambda row: f"{row.robot.name} {row.version.name if row.version else ''}",
        {
            "name": lambda row: row.robot.name,
            "error": lambda row: row.accuracy.mean if row.accuracy else None,
            "measured": lambda row: row.measured_at,
        },
        {"state": lambda row: row.state.look},
    )


@router.get("/")
def show_fleet(request: Request, database: DatabaseOfApp, settings: SettingsOfApp) -> HTMLResponse:
    """Show a row for each robot."""
    found = fleet(database, settings, Asked.from_request(request, ("state",)))
    return render(request, "fleet.html", fleet=found, part=found["part"], counts=COUNTS, ruler=found["ruler"])


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


Place = tuple[str, str, str]  # something to go to: its name, what it is, and its address


def find(database: Database, sought: str, robot: str) -> list[Place]:
    """Return the first places that fit, those of the robot that is looked at before others."""
    words = sought.casefold().split()
    fitting = (one for one in _places(database, words, robot) if all(word in one[0].casefold() for word in words))
    return [one for one, _ in zip(fitting, range(MOST), strict=False)]


def _places(database: Database, words: list[str], here: str) -> Iterator[Place]:
    names = [one.name for one in robots.list_robots(database, Page()).robots]
    named = [name for name in names if name == here or not words or any(word in name.casefold() for word in words)]
    named.sort(key=lambda name: name != here)
    yield from ((name, "robot", f"/robots/{name}") for name in named)
    yield from ((name, "view", address) for name, address in EVERYWHERE.items())
    for name in named[:MOST_ROBOTS]:
        yield from ((f"{name} {view}", "view", f"/robots/{name}{end}") for view, end in VIEWS.items())
        for version in versions.list_versions(database, name, Page(limit=EACH)).versions:
            yield (f"{name} {display_name(version)}", "version", f"/versions/{version.id}")
        for campaign in campaigns.list_campaigns(database, name, Page()).campaigns[-EACH:]:
            yield (f"{name} {campaign.name}", "campaign", f"/campaigns/{campaign.id}")
        for job in jobs.list_jobs(database, name, Page(limit=EACH)).jobs:
            yield (f"{name} {display_name(job)}", "job", f"/jobs/{job.id}")


@router.get("/find")
def show_found(
    request: Request,
    database: DatabaseOfApp,
    sought: Annotated[str, Query(max_length=100)] = "",
    robot: Annotated[str, Query(max_length=64)] = "",
) -> HTMLResponse:
    """Find what is called so; ``robot`` is the one that is looked at."""
    return render(request, "find.html", places=find(database, sought, robot))


MOST_SEARCHES = 12


@router.get("/jobs")
def list_jobs(request: Request, database: DatabaseOfApp, robot: str = "") -> HTMLResponse:
    """List the jobs of every robot that may be seen, or of one, newest first."""
    found, part = listed_jobs.select_jobs(
        database, robot or None, Asked.from_request(request, ("robot", "kind", "state"))
    )
    return render(request, "job_list/list.html", found=found, part=part, robot=robot)


@router.get("/jobs/compare")
def compare(
    request: Request,
    database: DatabaseOfApp,
    job: Annotated[list[str] | None, Query(max_length=MOST_SEARCHES)] = None,
) -> Response:
    """Compare searches that were ticked in the list, by the versions that they made."""
    wanted = list(dict.fromkeys(job or []))
    if len(wanted) < 2:
        raise ServiceError("Tick at least two searches to compare them.", code="option_invalid", option="job")
    robot = jobs.get(database, wanted[0]).robot
    asked = urlencode([("version", resolve_version_id(one)) for one in wanted])
    return redirect(request, f"/robots/{robot}/versions/compare?{asked}")
