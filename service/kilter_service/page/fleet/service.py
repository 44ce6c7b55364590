"""What a card of a robot shows."""

from __future__ import annotations

import math
from dataclasses import dataclass

from kilter_service.contract.robot_reports import RobotSummary
from kilter_service.contract.versions import Version
from kilter_service.db import Database
from kilter_service.jobs import service as jobs
from kilter_service.page.shared.accuracy import Accuracy, accuracy_of
from kilter_service.page.shared.correcting import Correcting, corrector
from kilter_service.paging import Page
from kilter_service.robots import service as robots
from kilter_service.settings import Settings
from kilter_service.versions import service as versions

OPEN = ("queued", "running")
LOOKED_AT = Page(limit=200)  # newest jobs among which the open ones are


@dataclass(frozen=True)
class Card:
    """A robot with the version that corrects it, None without one, and the number of its jobs that are not over."""

    robot: RobotSummary
    version: Version | None
    accuracy: Accuracy | None
    correcting: Correcting
    open_jobs: int

    @property
    def rank(self) -> tuple[bool, float]:
        """Those without a known error first, then the least accurate."""
        return self.accuracy is not None, -self.accuracy.mean if self.accuracy else math.inf


def cards(database: Database, settings: Settings) -> list[Card]:
    """Return the robots in use, worst first."""
    seen = corrector(database, settings)
    open_jobs = [job.robot for job in jobs.listed(database, None, LOOKED_AT).jobs if job.state in OPEN]
    made = []
    for robot in robots.listed(database, Page()).robots:
        version = None if robot.active_version is None else versions.get(database, robot.active_version)
        accuracy = None if version is None else accuracy_of(version.metrics)
        correcting = seen.of(robot.name, robot.active_version)
        made.append(Card(robot, version, accuracy, correcting, open_jobs.count(robot.name)))
    return sorted(made, key=lambda card: card.rank)
