"""What the server can say about its own state: each part by itself, and none that is away hides the others."""

from __future__ import annotations

import logging
import os
import shutil
import threading
import time
from collections.abc import Callable
from functools import cache, partial
from typing import Literal

from pydantic import Field

from kilter_service.contract.server import Check, Health
from kilter_service.ground.db import Database, revision
from kilter_service.ground.db.database import is_read_only
from kilter_service.ground.db.failures import Failing
from kilter_service.ground.settings import Settings, code_version
from kilter_service.web import store

log = logging.getLogger("kilter.api")
looks = {
    name: Failing(log, "the check of %s failed", name) for name in ("database", "disk", "worker", "corrector", "ros2")
}

SILENT_AFTER_S = 10.0
LEAST_FREE_MB = 200  # an upload of the largest size is on disk twice
BESIDE = "KILTER_BESIDE"  # processes that `kilterd serve` runs beside the API
BEGAN = "KILTER_BEGAN"  # when it began, on the system's monotonic clock
STARTING = "is starting"
LONGEST_START_S = 300.0  # as `kilterd serve` waits: the first start on a machine compiles the kernels
REMEDY = "its log says why; start `kilterd {}`"

ProcessState = Literal["alive", "starting", "stopped"]


class ProcessCheck(Check):
    """A look at a process; what it found in a word is for callers in this process, and is not sent."""

    state: ProcessState = Field("stopped", exclude=True)


def report(database: Database, settings: Settings) -> Health:
    """Check the database, the processes beside the API and the disk."""
    clock().sets_s()  # looked at each time, also when no heartbeat is read
    with database.looking() as looked:
        checks = {
            "database": _check("database", partial(_database, looked)),
            "disk": _check("disk", partial(_disk, settings)),
        }
        if checks["database"].ok:
            checks["worker"] = _check("worker", partial(_worker, looked))
            beside = os.environ.get(BESIDE, "").split(",")
            for process in ("corrector", "ros2"):
                checks[process] = _check(process, partial(_process, looked, process, process in beside))
    if settings.sqlite_file is not None and not checks["disk"].ok and is_read_only(settings.data):
        checks |= {name: _unheard(check) for name, check in checks.items() if name not in ("database", "disk")}
    ready = all(check.ok for check in checks.values())
    return Health(status="ready" if ready else "not_ready", version=code_version(), checks=checks)


@cache
def clock() -> SetClock:
    """What this process knows of the machine's clock, from its first call on."""
    return SetClock(SILENT_AFTER_S)


def _check(name: str, look: Callable[[], Check]) -> Check:
    """What a look at a part finds; that it cannot be looked at is a finding."""
    try:
        found = look()
    except Exception as error:  # the driver's, the system's: whatever it is, the document is what helps
        looks[name].report_failure(error)
        remedy = (
            "see that it runs and can be reached, KILTER_DATABASE_URL says where"
            if name == "database"
            else "see the log"
        )
        return Check(ok=False, detail=f"cannot be read ({type(error).__name__}): {remedy}")
    looks[name].report_success()
    return found


def _database(database: Database) -> Check:
    found = revision.current(database)
    if found == revision.HEAD:
        return Check(ok=True, detail=f"revision {found}")
    return Check(ok=False, detail=f"revision {found or 'none'}, needed {revision.HEAD}: run `kilterd migrate`")


def _disk(settings: Settings) -> Check:
    if is_read_only(settings.data):
        return Check(ok=False, detail=f"{settings.data} cannot be written: mount it for writing")
    free = shutil.disk_usage(settings.data).free >> 20
    if free < LEAST_FREE_MB:
        return Check(
            ok=False, detail=f"{free} MB are free, {LEAST_FREE_MB} MB are needed: make room in {settings.data}"
        )
    return Check(ok=True, detail=f"{free} MB are free")


def _worker(database: Database) -> Check:
    """Any worker will do: those that were killed do not count."""
    found = _heartbeats(database, "worker")
    alive = [one for one in found if _alive(one)]
    if alive:
        return Check(ok=True, detail=f"{len(alive)} alive{_was_set()}")
    why = (
        _ahead(found)
        or _starting("worker", found)
        or f"no worker spoke in the last {SILENT_AFTER_S:.0f} s: start `kilterd worker`"
    )
    return Check(ok=False, detail=why)


def _process(database: Database, process: str, expected: bool) -> Check:
    """One that must run: it said that it does and not that it has stopped, or `kilterd serve` runs it beside the API."""
    found = _heartbeats(database, process)
    starting = _starting(process, found)
    if starting:
        return ProcessCheck(ok=False, detail=starting, state="starting")
    if not found:
        said = f"has not spoken yet: {REMEDY.format(process)}" if expected else "none was started"
        return Check(ok=not expected, detail=said)
    silent = [one for one in found if not _alive(one)]
    if not silent:
        return ProcessCheck(ok=True, detail=f"{len(found)} alive{_was_set()}", state="alive")
    names = ", ".join(one.name for one in silent)
    said = f"{names} last spoke {max(one.age_s for one in silent):.0f} s ago: {REMEDY.format(process)}"
    return Check(ok=False, detail=_ahead(silent) or said)


def _unheard(check: Check) -> Check:
    """A process that is silent where nobody can speak."""
    return check if check.ok else Check(ok=False, detail="cannot say that it is alive: the disk cannot be written")


def _heartbeats(database: Database, process: str) -> list[store.Heartbeat]:
    with database.reading() as session:
        return store.heartbeats(session, process)


def _starting(process: str, found: list[store.Heartbeat]) -> str | None:
    """What to say of a process that `kilterd serve` started with the server, and that has not spoken since."""
    began = os.environ.get(BEGAN)
    if began is None or process not in os.environ.get(BESIDE, "").split(","):
        return None
    since_s = time.monotonic() - float(began)
    spoken = any(_alive(one) or abs(one.age_s) <= since_s for one in found)
    return None if spoken or since_s > LONGEST_START_S else f"{STARTING}, for {since_s:.0f} s"


def _alive(one: store.Heartbeat) -> bool:
    return any(abs(one.age_s - by_s) <= SILENT_AFTER_S for by_s in (0.0, *clock().sets_s()))


def _was_set() -> str:
    """What to say when the clock was set a moment ago: heartbeats may be dated by the clock as it was before."""
    by_s = max(clock().sets_s(), key=abs, default=0.0)
    if not by_s:
        return ""
    return f"; the clock was just set {'forward' if by_s > 0 else 'back'} by {abs(by_s):.0f} s"


def _ahead(found: list[store.Heartbeat]) -> str | None:
    """What to say of a process that speaks from the future: nobody knows whether it is alive."""
    ahead = [one for one in found if one.age_s < -SILENT_AFTER_S]
    if not ahead:
        return None
    return (
        f"{ahead[0].name} spoke {-ahead[0].age_s:.0f} s in the future: set the clocks of the machines to the same time; "
        "where one clock was set back, and it stays silent, start it"
    )


LEAST_S = 2.0  # a clock that is disciplined creeps, and is never set by so much


class SetClock:
    """Compares the time of day with the monotonic clock each time it is asked."""

    def __init__(
        self, for_s: float, clock: Callable[[], float] = time.time, steady: Callable[[], float] = time.monotonic
    ) -> None:
        self._for_s, self._clock, self._steady = for_s, clock, steady
        self._lock = threading.Lock()
        self._between = clock() - steady()
        self._sets: list[tuple[float, float]] = []

    def sets_s(self) -> list[float]:
        """By how much it was set in the last seconds, forward positive; each as a heartbeat from before it shows it."""
        with self._lock:
            steady_s = self._steady()
            between = self._clock() - steady_s
            self._sets = [(at, s) for at, s in self._sets if steady_s - at < self._for_s]
            by = between - self._between
            if abs(by) > LEAST_S:
                self._sets = [(at, s + by) for at, s in self._sets] + [(steady_s, by)]
            self._between = between
            return [s for _, s in self._sets]
