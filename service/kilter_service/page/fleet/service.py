"""What a card of a robot shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from kilter_service.contract.drift import DriftSummary
from kilter_service.contract.robot_reports import RobotSummary
from kilter_service.contract.today import Today
from kilter_service.contract.versions import VersionSummary
from kilter_service.ground.db import Database
from kilter_service.ground.paging import Page
from kilter_service.ground.settings import Settings
from kilter_service.jobs import service as jobs
from kilter_service.page.shared.accuracy import Accuracy, accuracy_today
from kilter_service.page.shared.control_chart import LOOKS, standing
from kilter_service.page.shared.correcting import OFF, OTHER, Correcting, corrector
from kilter_service.page.shared.lists import Asked, Part, select_page
from kilter_service.page.shared.state import State, assess_robot_state
from kilter_service.robots import service as robots
from kilter_service.versions import service as versions
from kilter_service.versions.drift import service as drift
from kilter_service.versions.today import service as today
from kilter_service.versions.today.sentences import describe_change

ALARMS = ("moved", "cannot_tell", "creeping")


@dataclass(frozen=True)
class Card:
    """A robot with the version that corrects it, None without one, and the number of its jobs that are not over."""

    robot: RobotSummary
    version: VersionSummary | None
    today: Today | None
    accuracy: Accuracy | None
    correcting: Correcting
    open_jobs: int
    drift: DriftSummary | None

    @property
    def state(self) -> str:
        """Good as far as is known, changed since its fit, or not corrected, as the card says it."""
        if self.stands.word in (OFF, OTHER):
            return "uncorrected"
        return "changed" if self.today is not None and self.today.changed else "corrected"

    @property
    def stands(self) -> State:
        """How the robot stands, as its own view says it."""
        return assess_robot_state(self.today, self.accuracy, self.drift, self.correcting)

    @property
    def rank(self) -> tuple[int, bool, float]:
        """Those that a check says have moved first, then those without a known error, then the least accurate."""
        moved = len(ALARMS) if self.drift is None or self.drift.state not in ALARMS else ALARMS.index(self.drift.state)
        return moved, self.accuracy is not None, -self.accuracy.mean if self.accuracy else math.inf

    @property
    def badge(self) -> tuple[str, str]:
        """How the robot stands by its checks as words of a badge, and its look."""
        return LOOKS["never" if self.drift is None else self.drift.state]

    @property
    def checked(self) -> str:
        """What the checks say where it is not well, and when the last one was."""
        if self.drift is None:
            return ""
        return (
            standing(self.drift)
            if self.drift.state == "ok"
            else f"{self.drift.sentence} {standing(self.drift)}".strip()
        )


def cards(database: Database, settings: Settings) -> list[Card]:
    """Return the robots in use, worst first."""
    seen = corrector(database, settings)
    open_jobs, active = jobs.open_of_robots(database), versions.active_of_robots(database)
    known, checked = today.of_robots(database), {one.robot: one for one in drift.of_robots(database).robots}
    made = []
    for robot in robots.list_robots(database, Page()).robots:
        version = active.get(robot.name)
        now = known.get(robot.name)
        accuracy = None if now is None else accuracy_today(now)
        correcting = seen.describe_correction(robot.name, robot.active_version, robot.controller_compensation)
        jobs_open, drifted = open_jobs.get(robot.name, 0), checked.get(robot.name)
        made.append(Card(robot, version, now, accuracy, correcting, jobs_open, drifted))
    return sorted(in_one_unit(made), key=lambda card: card.rank)


def in_one_unit(made: Sequence[Card]) -> list[Card]:
    """Return cards whose errors all have the unit of the largest: robots are compared by them."""
    most = max((card.accuracy.widest for card in made if card.accuracy is not None), default=0.0)
    out = []
    for card in made:
        if card.accuracy is None or card.today is None:
            out.append(card)
            continue
        now = card.today
        said = describe_change(now.robot, now.newest, now.own, now.larger_by_mm, most)
        same = now.model_copy(update={"compared": said})
        out.append(replace(card, accuracy=replace(card.accuracy, widest=most), today=same))
    return out


def select_cards(made: list[Card], asked: Asked) -> Part[Card]:
    """Return the cards that the address asks for; without a column they stay worst first."""
    return select_page(
        made,
        asked,
        lambda card: f"{card.robot.name} {card.version.name if card.version else ''}",
        {
            "name": lambda card: card.robot.name,
            "error": lambda card: card.accuracy.mean if card.accuracy else None,
            "jobs": lambda card: card.open_jobs,
        },
        {"state": lambda card: card.state},
    )
