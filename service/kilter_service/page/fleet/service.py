"""What a row of the fleet shows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from markupsafe import Markup

from kilter_service.contract.robot_reports import RobotSummary
from kilter_service.contract.today import NextStep, Today
from kilter_service.contract.versions import VersionSummary
from kilter_service.ground.db import Database
from kilter_service.ground.paging import Page
from kilter_service.ground.settings import Settings
from kilter_service.jobs import service as jobs
from kilter_service.page.figures import strip
from kilter_service.page.figures.scale import Axis, lengths
from kilter_service.page.shared.accuracy import Accuracy, accuracy_today
from kilter_service.page.shared.correcting import Correcting, corrector
from kilter_service.page.shared.lists import Asked, Part, select_page
from kilter_service.page.shared.state import LOUDNESS, State, assess_robot_state
from kilter_service.page.words import format_in_largest_unit
from kilter_service.robots import service as robots
from kilter_service.versions import service as versions
from kilter_service.versions.drift import service as drift
from kilter_service.versions.today import service as today

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


@dataclass(frozen=True)
class Fleet:
    """The rows that are shown, how many there are of each look, and the axis on which all errors are."""

    part: Part[Row]
    counts: Mapping[str, int]
    axis: Axis
    most: float

    def drawn(self, row: Row) -> Markup | str:
        """The error of a row on the shared axis."""
        found, standing = row.accuracy, row.today.standing
        if found is None or standing is None:
            return ""
        low, high = found.low or found.mean, found.high or found.mean
        title = f"Mean error {format_in_largest_unit(found.mean, self.most)}"
        return strip.error(self.axis, found.mean, low, high, standing.tolerance_mm, row.state.look, title)


def fleet(database: Database, settings: Settings, asked: Asked) -> Fleet:
    """Return the robots in use that the address asks for, worst first."""
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
    return Fleet(
        select_rows(rows, asked),
        {look: sum(row.state.look == look for row in rows) for look in COUNTS},
        lengths("mean error", shown, log=True),
        max((one.mean for one in found), default=1.0),
    )


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
