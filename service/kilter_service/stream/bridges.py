"""What bridges say of themselves, and what is to be said of them: who corrects an arm, since when, and that it is gone."""

from __future__ import annotations

from datetime import datetime

from kilter_service.contract.streams import Bridge, BridgeList, BridgeNews
from kilter_service.contract.units import ControllerCompensation
from kilter_service.ground.db import Database
from kilter_service.robots import store as robots
from kilter_service.robots.compensation import CORRECTS, parse_compensation, perhaps_twice
from kilter_service.robots.compensation import twice as corrected_twice
from kilter_service.stream import store
from kilter_service.versions import store as versions

SILENT_S = 6.0  # a bridge speaks every 2 s
FORGOTTEN_S = 86_400.0
MOST = 20  # of one robot, the last heard
MAKERS = {"rsi": "KUKA", "egm": "ABB", "fci": "Franka"}
OFFSETTING = ("ramping in", "correcting")
IDLE = {
    "starting": "waits until the controller has been silent",
    "waiting": "waits for the controller",
    "refusing": "gives no answer",
    "ramping in": "brings the correction in",
    "correcting": "corrects the arm",
    "holding back": "lets the correction go out",
    "fading out": "lets the correction go out",
    "off": "does not correct",
}


def announce(database: Database, robot: str, run: str, news: BridgeNews) -> Bridge:
    """Keep what a bridge says of itself.

    Raises:
        ServiceError: there is no such robot.

    """
    with database.transaction() as session:
        key = robots.get(session, robot).id
        store.note(session, key, run, news.model_dump())
        store.forget(session, key, FORGOTTEN_S, MOST)
    return next(one for one in of_robot(database, robot).bridges if one.id == run)


def of_robot(database: Database, robot: str) -> BridgeList:
    """Return the bridges of a robot.

    Raises:
        ServiceError: no such robot.

    """
    with database.reading() as session:
        stored = robots.get(session, robot)
        entry = versions.active_entry(session, stored.id)
        found = store.list_bridges(session, stored.id)
        controller = parse_compensation(robots.get_compensation(session, stored.id))
    active = None if entry is None else entry.version_id
    known = [_bridge(robot, one, active, controller) for one in found if one.silent_s < FORGOTTEN_S]
    return BridgeList(bridges=sorted(known, key=lambda one: one.gone))


def of_robots(database: Database) -> dict[str, list[Bridge]]:
    """Return the bridges of all robots that have some, by name."""
    with database.reading() as session:
        names = robots.names_by_key(session, None)
        found = [one for one in store.list_bridges(session) if one.silent_s < FORGOTTEN_S and one.robot_id in names]
        keys = {one.robot_id for one in found}
        active = {key: versions.active_entry(session, key) for key in keys}
        controllers = {key: parse_compensation(robots.get_compensation(session, key)) for key in keys}
    known: dict[str, list[Bridge]] = {}
    for one in found:
        entry, name = active[one.robot_id], names[one.robot_id]
        version = None if entry is None else entry.version_id
        known.setdefault(name, []).append(_bridge(name, one, version, controllers[one.robot_id]))
    return {name: sorted(bridges, key=lambda one: one.gone) for name, bridges in known.items()}


def _bridge(robot: str, known: store.Known, active: str | None, controller: ControllerCompensation) -> Bridge:
    details = dict(known.details)
    since = datetime.fromisoformat(details.pop("since"))
    news = BridgeNews.model_validate(details)
    over = news.state in ("ended", "killed")
    silent = known.silent_s >= SILENT_S
    offset = news.state in OFFSETTING or news.offset_deg > 0.0
    both = controller in CORRECTS and offset and news.state != "ended"
    twice = both and not (over or silent)
    more = f" {corrected_twice(robot, controller) if twice else perhaps_twice(robot, controller)}" if both else ""
    return Bridge(
        **news.model_dump(),
        id=known.run,
        robot=robot,
        since=since,
        heard_at=known.heard_at,
        silent_s=round(max(0.0, known.silent_s), 1),
        gone=over or silent,
        other_version=news.version_id != active,
        corrected_twice=twice,
        sentence=_sentence(news, known.silent_s, active) + more,
    )


def _sentence(news: BridgeNews, silent_s: float, active: str | None) -> str:
    name = f"The {news.kind} bridge ({MAKERS[news.kind]})"
    if news.state == "ended":
        return f"{name} has ended: it does not correct the arm any more."
    if news.state == "killed":
        return f"{name} was killed {_ago(silent_s)}: its controller stops, or drives the arm with the last offsets."
    if silent_s >= SILENT_S:
        return (
            f"{name} was last heard {_ago(silent_s)}: it was killed, or cannot reach the server. "
            "Whether it corrects the arm is not known."
        )
    why = f": {news.why}" if news.why and news.state not in ("ramping in", "correcting", "waiting") else ""
    said = f"{name} {IDLE[news.state]} with version {news.version_id}{why}"
    other = (
        "" if news.version_id == active else "; that is not the active version" if active else "; no version is active"
    )
    return f"{said}{other}."


def _ago(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s ago"
    return f"{seconds / 60.0:.0f} min ago" if seconds < 7200.0 else f"{seconds / 3600.0:.0f} h ago"
