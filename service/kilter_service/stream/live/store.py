"""What the database knows of the streams of a robot."""

from __future__ import annotations

from typing import Any, NamedTuple

from kilter_service.ground.db import Session
from kilter_service.robots import store as robots
from kilter_service.robots.compensation import objection
from kilter_service.versions import store as versions
from kilter_service.web.health import store as health
from kilter_service.web.observability import store as reports


class Known(NamedTuple):
    """The active version, whether some corrector says that it is alive, and what it last said of the robot's streams.

    ``twice`` says that the controller corrects by itself, so that the corrector does not; empty where it does not.
    """

    active_version: str | None = None
    alive: bool = False
    reports: tuple[dict[str, Any], ...] = ()
    twice: str = ""


def load_robot_state(session: Session, robot: str, within_s: float) -> Known:
    """Look up a robot."""
    stored = robots.get(session, robot)
    active, twice = versions.active_entry(session, stored.id), objection(robot, stored.controller_compensation)
    alive = any(abs(beat.age_s) < within_s for beat in health.heartbeats(session, "corrector"))
    told = tuple(report for report in reports.streams(session) if report["robot"] == robot) if alive else ()
    return Known(None if active is None else active.version_id, alive, told, "" if twice is None else twice.message)
