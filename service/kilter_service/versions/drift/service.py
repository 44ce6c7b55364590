"""How robots stand by their checks: every surface shows what is computed here."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import partial
from itertools import pairwise
from typing import Any

from kilter_service.contract.today import (
    CheckOfRobot,
    ControlChart,
    DriftHistory,
    DriftList,
    DriftMark,
    DriftSummary,
    Mark,
    Repair,
    State,
)
from kilter_service.ground.db import Database, Session
from kilter_service.ground.db.row import days_since
from kilter_service.ground.naming import copy_fields
from kilter_service.robots import store as robots
from kilter_service.versions.drift import store
from kilter_service.versions.drift.wire import FALSE_ALARM, RUN_LENGTH, Activated, KeptCharts, StoredCheck, height


def check(one: StoredCheck) -> CheckOfRobot:
    """Say what a check said."""
    return copy_fields(
        CheckOfRobot,
        one,
        version_id=str(one.result["version_id"]),
        verdict=one.result["verdict"],
        sentence=str(one.result["sentence"]),
        p_value=float(one.result["p_value"]),
        temperature_c=one.result.get("temperature_c"),
    )


def mark(one: Activated) -> DriftMark:
    """Say what was done to a robot's version."""
    what: Mark = "rolled back" if one.action == "rollback" else "re-zeroed" if one.rezeroed else "activated"
    return DriftMark(at=one.at, what=what, version_id=one.version_id)


def repair(one: Repair) -> DriftMark:
    """Say what somebody did to the arm."""
    return DriftMark(at=one.at, what="repair", version_id="", note=one.what, repair_id=one.id)


def note(one: Repair) -> DriftMark:
    """A note that somebody left on a date, a campaign or its rows."""
    return repair(one).model_copy(update={"what": "note", "campaign_id": one.campaign_id, "rows": one.rows})


def valid_again_mark(first: StoredCheck) -> DriftMark:
    """Say that a version holds again since a check."""
    return DriftMark(at=first.at, what="repaired", version_id=str(first.result["version_id"]))


KEPT = KeptCharts()
MOST_SUMMED, SUMMED_S = 20, 600.0  # robots whose sums one scrape computes, and how long they hold without a check
MOST_OF_LAST = 5  # looked through for the last one that counts
WORST = ("moved", "cannot_tell", "creeping", "never", "ok")
NEVER = "Not checked since {since}: measure five poses and send them (kilter check)."
UNCORRECTED = "It has no active version that could be checked."


def of_robot(database: Database, robot: str) -> DriftHistory:
    """Return the checks of a robot, its charts, and how it stands."""
    with database.reading() as session:
        ((key, name),) = robots.names_by_key(session, robot).items()
        made = store.checks(session, [key]).get(key, [])
        log = store.activations(session, [key]).get(key, [])
        repaired = robots.of_robots(session, [key]).get(key, [])
        noted = robots.of_robots(session, [key], "note").get(key, [])
        own, charts = _checks_and_charts(session, made, log, repaired)
    marks = [*map(mark, log), *_agreeing_again(made), *map(repair, repaired), *map(note, noted)]
    return DriftHistory(
        **_summary(name, _describe_start_of_checks(made, log, repaired), log, own, charts).model_dump(),
        repaired_at=repaired[-1].at if repaired else None,
        history=[check(one) for one in made],
        marks=sorted(marks, key=lambda one: one.at),
        charts=charts,
        run_length=RUN_LENGTH,
        false_alarm=FALSE_ALARM,
    )


def of_robots(database: Database) -> DriftList:
    """Return how all robots stand, the worst first."""
    with database.reading() as session:
        found = summaries(session, robots.names_by_key(session, None))
    return DriftList(robots=sorted(found.values(), key=_order))


def activations_of_robots(database: Database) -> dict[str, list[datetime]]:
    """Return when versions were activated, by robot."""
    with database.reading() as session:
        names = robots.names_by_key(session, None)
        return {names[key]: [one.at for one in log] for key, log in store.activations(session, names).items()}


def summaries(session: Session, names: Mapping[int, str]) -> dict[int, DriftSummary]:
    """Return how robots stand by their checks, by key."""
    made, log = store.checks(session, names), store.activations(session, names)
    repaired = robots.of_robots(session, names)
    found = {}
    for key, name in names.items():
        known = made.get(key, []), log.get(key, []), repaired.get(key, [])
        since = _describe_start_of_checks(*known)
        found[key] = _summary(name, since, log.get(key, []), *_checks_and_charts(session, *known))
    return found


def last_checks(session: Session) -> dict[str, CheckOfRobot]:
    """Return the last check of the active version of each robot, by name; reads few rows, for the metrics."""
    names = robots.names_by_key(session, None)
    made, log = store.checks(session, names, MOST_OF_LAST), store.activations(session, names)
    repaired = robots.of_robots(session, names)
    own = {key: _of_active(found, log.get(key, []), repaired.get(key, [])) for key, found in made.items()}
    return {names[key]: check(found[-1]) for key, found in own.items() if found}


class Creeping:
    """Which robots creep, for the metrics: their sums are computed when a check came, and again after a while.

    A few robots each time, so that no scrape of a large fleet waits for all.
    """

    def __init__(self, most: int = MOST_SUMMED, kept_s: float = SUMMED_S) -> None:
        self._most, self._kept_s = most, kept_s
        self._known: dict[
            str, tuple[str, float, bool]
        ] = {}  # by robot: its last check, until when it holds, what it is

    def creeping_by_robot(self, session: Session, last: Mapping[str, CheckOfRobot]) -> dict[str, bool]:
        """Whether each robot of these last checks creeps, as far as it is known already."""
        now = time.monotonic()
        due = [name for name, one in last.items() if self._is_due(name, one, now)][: self._most]
        keys = {name: key for key, name in robots.names_by_key(session, None).items() if name in due}
        made = store.checks(session, keys.values())
        log, repaired = store.activations(session, keys.values()), robots.of_robots(session, keys.values())
        for name, key in keys.items():
            charts = _checks_and_charts(session, made.get(key, []), log.get(key, []), repaired.get(key, []))[1]
            creeps = last[name].verdict == "ok" and any(one.alarms for one in charts)
            self._known[name] = (last[name].job_id, now + self._kept_s, creeps)
        self._known = {name: one for name, one in self._known.items() if name in last}
        return {name: creeps for name, (job, _, creeps) in self._known.items() if job == last[name].job_id}

    def _is_due(self, name: str, one: CheckOfRobot, now: float) -> bool:
        job, until, _ = self._known.get(name, ("", 0.0, False))
        return job != one.job_id or now > until


def _agreeing_again(made: Sequence[StoredCheck]) -> list[DriftMark]:
    """Checks that agree again with a version that the one before missed; not by frames that took up what it said."""
    return [
        valid_again_mark(after)
        for before, after in pairwise([one for one in made if one.whole])
        if before.result.get("version_id") == after.result.get("version_id")
        and before.result["verdict"] != "ok"
        and after.result["verdict"] == "ok"
    ]


def _active(log: Sequence[Activated]) -> str | None:
    return log[-1].version_id if log else None


def _order(one: DriftSummary) -> tuple[int, float, str]:
    chance = 1.0 if one.last is None else one.last.p_value
    return WORST.index(one.state), chance, one.robot


def _of_active(made: Sequence[StoredCheck], log: Sequence[Activated], repaired: Sequence[Repair]) -> list[StoredCheck]:
    """The checks of the active version since the last repair: those before it are of the arm as it was."""
    active = _active(log)
    own = [one for one in made if active is not None and one.result.get("version_id") == active]
    return [one for one in own if not repaired or one.at >= repaired[-1].at]


def _checks_and_charts(
    session: Session, made: Sequence[StoredCheck], log: Sequence[Activated], repaired: Sequence[Repair]
) -> tuple[list[StoredCheck], list[ControlChart]]:
    """The checks of the active version since the last repair, and the charts of those that looked at every cause."""
    own = _of_active(made, log, repaired)
    return own, KEPT.get_charts([one for one in own if one.whole], partial(store.with_numbers, session))


def _summary(
    robot: str, since: str, log: Sequence[Activated], own: Sequence[StoredCheck], charts: Sequence[ControlChart]
) -> DriftSummary:
    alarmed = [one for one in charts if one.alarms]
    last = own[-1] if own else None
    state, sentence = _stand(last.result if last else None, alarmed, since)
    return DriftSummary(
        robot=robot,
        state=state,
        version_id=_active(log),
        sentence=sentence,
        checks=len(own),
        last=None if last is None else check(last),
        age_days=None if last is None else days_since(last.at),
    )


def _describe_start_of_checks(made: Sequence[StoredCheck], log: Sequence[Activated], repaired: Sequence[Repair]) -> str:
    """Since when checks of the active version count, in words; empty without one.

    Rows that are sent late are dated before the activation of their version, and a repair after them may be, too.
    """
    if not log:
        return ""
    if repaired and (repaired[-1].at > log[-1].at or _of_active(made, log, [])):
        return f"the repair of {repaired[-1].at:%Y-%m-%d} ({repaired[-1].what})"
    return "its version was activated"


def _stand(last: Mapping[str, Any] | None, alarmed: Sequence[ControlChart], since: str) -> tuple[State, str]:
    if last is None:
        return "never", NEVER.format(since=since) if since else UNCORRECTED
    verdict: State = last["verdict"]
    if verdict != "ok" or not alarmed:
        return verdict, str(last["sentence"])
    most = max(alarmed, key=height)
    began = "" if most.since is None else f", since {most.since:%Y-%m-%d} at the latest"
    return (
        "creeping",
        f"creeping: most like {most.words}{began}. No single check says so; all together do, by their cumulative sum. Another "
        "cause may look like it: a check with more poses says which it is.",
    )
