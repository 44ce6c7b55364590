"""What is known of the streams of a robot at this moment, without waiting for news."""

from __future__ import annotations

import time

from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.stream import store
from kilter_service.stream.live.followers import ALIVE_S
from kilter_service.stream.live.heard import Heard, Reach, RobotShown, Second, bypass
from kilter_service.stream.live.session import read_corrector_place


def load_minutes(database: Database, robot: str) -> dict[str, list[Second]]:
    """Return the last minute of each stream of a robot, as the correctors last reported it, by the stream's name.

    Raises:
        ServiceError: no such robot.

    """
    with database.reading() as session:
        known = store.load_robot_state(session, robot, ALIVE_S)
    found = {}
    for report in known.reports:
        heard = Heard()
        heard.take_report(report, time.time_ns(), time.monotonic())
        found[report["stream"]] = heard.minute()
    return found


def load_robot_view(database: Database, settings: Settings, robot: str) -> RobotShown:
    """Return what the corrector last said in the database, every two seconds.

    Raises:
        ServiceError: no such robot.

    """
    with database.reading() as session:
        known = store.load_robot_state(session, robot, ALIVE_S)
    streams = []
    for report in known.reports:
        heard = Heard()
        heard.take_report(report, time.time_ns(), time.monotonic())
        streams.append(heard.stream_view(report["stream"], time.monotonic()))
    place = read_corrector_place(settings.corrector_file)
    reach: Reach = "away" if not known.alive and place is None else "connecting"
    since = place.since if place else None
    why = bypass(reach, known.active_version, streams, known.twice)
    return RobotShown(robot, reach, since, known.active_version, why, streams)
