"""What is posted when a robot begins to creep, and when it no longer does: each once, whichever worker sees it first."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

from kilter_service.contract.drift import ControlChart, DriftHistory
from kilter_service.ground.db import Database
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.failure_log import Failing
from kilter_service.ground.webhook import Webhook
from kilter_service.versions.drift import service as drift
from kilter_service.versions.drift import store
from kilter_service.versions.drift.charts import height

EVERY_S = 60.0  # how often robots that creep are looked at: a repair or another version ends it without a check
BEGAN, ENDED = "creeping_began", "creeping_ended"
REMEDY = (
    "`kilter watch drift {robot}` shows the sums. Check with more poses, which name the cause; then repair the arm, "
    "re-zero what "
    "moved (kilter watch rezero), or identify it anew."
)


class CreepingPosts:
    """Looks at the sums of a robot after each of its checks, and at those of robots that creep every minute.

    What was told stands in the database, so that it is told once by any number of workers and after any restart.
    """

    def __init__(self, database: Database, webhook: Webhook, clock: Callable[[], float] = time.monotonic) -> None:
        self._database, self._webhook, self._clock = database, webhook, clock
        self._next_s = clock()
        self._failing = Failing(logging.getLogger("kilter.worker"), "whether robots creep could not be told")

    def post_changes_if_due(self) -> None:
        """See whether robots that were told to creep still do, when it is time."""
        if self._clock() < self._next_s:
            return
        self._next_s = self._clock() + EVERY_S
        self._trying(self._post_changes)

    def post_changes_after_check(self, robot: str) -> None:
        """See what a check has changed."""
        self._trying(lambda: self._post_changes_of_robot(robot))

    def _post_changes(self) -> None:
        with self._database.reading() as session:
            told = store.told_creeping(session)
        for robot in told:
            self._post_changes_of_robot(robot)

    def _trying(self, see: Callable[[], None]) -> None:
        try:
            see()
        except Exception as error:  # nothing of this holds up a job or ends the worker
            self._failing.report_failure(error)
        else:
            self._failing.report_success()

    def _post_changes_of_robot(self, robot: str) -> None:
        found = drift.of_robot(self._database, robot)
        if found.state == "creeping" and found.last is not None:
            with self._database.transaction() as session:
                began = store.note_creeping(session, robot, found.last.job_id)
            if began:
                self._webhook.enqueue_message(f"{found.last.job_id}-{BEGAN}", _message(BEGAN, found.last.job_id, found))
            return
        with self._database.transaction() as session:
            job = store.forget_creeping(session, robot)
        if job is not None:
            self._webhook.enqueue_message(f"{job}-{ENDED}", _message(ENDED, job, found))


def _message(event: str, job: str, found: DriftHistory) -> dict[str, Any]:
    alarmed: list[ControlChart] = sorted((one for one in found.charts if one.alarms), key=height, reverse=True)
    alarmed = alarmed if event == BEGAN else []
    since = alarmed[0].since if alarmed else None
    return {
        "event": event,
        "job_id": job,
        "robot": found.robot,
        "version_id": found.version_id,
        "at": utc_now().isoformat(),
        "state": found.state,
        "sentence": found.sentence,
        "remedy": REMEDY.format(robot=found.robot) if event == BEGAN else "",
        "since": None if since is None else since.isoformat(),
        "causes": [{"name": one.name, "words": one.words} for one in alarmed],
    }
