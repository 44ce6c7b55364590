"""Jobs are counted when they end: the counter and the histogram of `/metrics` never fall."""

from __future__ import annotations

from datetime import timedelta

import httpx
import numpy as np
import pytest
from alembic import command
from prometheus_client.parser import text_string_to_metric_families

from kilter_service.ground.db import Database, revision
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import FleetJobRow, FleetRobotRow, HeartbeatRow, JobRow, RobotRow
from kilter_service.ground.settings import Settings
from kilter_service.ground.store import AT_MOST_MS
from kilter_service.jobs import store
from kilter_service.jobs.fleet import store as fleet
from kilter_service.jobs.work import store as lease
from kilter_service.jobs.work import worker
from kilter_service.versions import metrics
from tests.service.conftest import Katana

LONG_AGO = timedelta(days=40)


@pytest.fixture
def robot_id(client: httpx.Client, database: Database, katana: Katana) -> int:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    with database.reading() as session:
        return session.query(RobotRow).one().id


def began(database: Database, name: str, robot_id: int, ran: timedelta | None = timedelta(0)) -> str:
    """A job that has run for some time; None: it waits."""
    at = utc_now() - (ran or timedelta(0))
    row = JobRow(
        id=f"job_{name}", kind="plan", robot_id=robot_id, request={}, state="queued" if ran is None else "running",
        created_at=at, started_at=None if ran is None else at, worker="w", attempts=1,
    )  # fmt: skip
    with database.transaction() as session:
        session.add(row)
    return row.id


def given(settings: Settings) -> dict[tuple[str, ...], float]:
    """Samples of the jobs that ended, as a process that has just started gives them: by name, state and edge."""
    database = Database(settings.database)
    try:
        page = metrics.text(database, settings).decode()
    finally:
        database.close()
    found: dict[tuple[str, ...], float] = {}
    for family in text_string_to_metric_families(page):
        if family.name in ("kilter_jobs_ended", "kilter_job_duration_seconds"):
            for one in family.samples:
                assert one.labels["kind"] == "plan"
                found[one.name, one.labels["state"], one.labels.get("le", "")] = one.value
    return found


@pytest.mark.both_databases
def test_the_counter_does_not_fall_when_jobs_are_purged_or_the_server_starts_again(
    database: Database, settings: Settings, robot_id: int
) -> None:
    for number in range(3):
        job = began(database, f"done{number}", robot_id)
        with database.transaction() as session:
            store.succeed(session, job, {}, None, [])
            store.succeed(session, job, {}, None, [])  # whoever says it twice is counted once
    for name, ran in (("waits", None), ("runs", timedelta(seconds=2))):
        job = began(database, name, robot_id, ran)
        with database.transaction() as session:
            store.cancel(session, job)
    before = given(settings)
    ended = ("kilter_jobs_ended_total", "succeeded", ""), ("kilter_jobs_ended_total", "cancelled", "")
    assert [before[one] for one in ended] == [3, 2]
    assert before["kilter_job_duration_seconds_count", "cancelled", ""] == 1  # the other never ran
    with database.transaction() as session:
        for row in session.query(JobRow):
            row.finished_at = utc_now() - LONG_AGO
    assert worker.purge(database, timedelta(days=30), "test") == 5
    assert given(settings) == before


def test_durations_fall_into_the_bins_that_they_belong_to(
    database: Database, settings: Settings, robot_id: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    durations_s = [0.1, 0.9, 4.0, 4.5, 40.0, 500.0, 5000.0]
    for number, seconds in enumerate(durations_s):
        job = began(database, str(number), robot_id)
        with database.transaction() as session:
            started = session.get_one(JobRow, job).started_at
            assert started is not None
            end = started + timedelta(seconds=seconds)  # by the clock, however busy the machine is
            monkeypatch.setattr(store, "utc_now", lambda end=end: end)
            store.fail(session, job, "internal_error", "it failed")
    found = given(settings)
    edges_s = [edge * 1e-3 for edge in AT_MOST_MS]
    expected = np.cumsum(np.histogram(durations_s, bins=[0.0, *edges_s, np.inf])[0])
    told = [found["kilter_job_duration_seconds_bucket", "failed", f"{edge!r}"] for edge in edges_s]
    assert [*told, found["kilter_job_duration_seconds_bucket", "failed", "+Inf"]] == list(expected)
    assert found["kilter_job_duration_seconds_sum", "failed", ""] == pytest.approx(sum(durations_s))


def test_several_that_end_in_one_transaction_are_all_counted(
    database: Database, settings: Settings, robot_id: int
) -> None:
    for name in ("a", "b", "c"):  # their worker is gone, after the last time that is tried
        began(database, name, robot_id)
    with database.transaction() as session:
        for row in session.query(JobRow):
            row.attempts = lease.MAX_ATTEMPTS
    with database.transaction() as session:
        assert len(lease.orphans(session)) == 3
    assert given(settings)["kilter_jobs_ended_total", "failed", ""] == 3
    fleet_job = FleetJobRow(id="flt_1", request={})
    with database.transaction() as session:
        session.add(fleet_job)
        session.add(HeartbeatRow(process=lease.WORKER, name="w", pid=1, at=utc_now()))
    job = began(database, "of_fleet", robot_id)
    with database.transaction() as session:
        session.add(FleetRobotRow(fleet_id="flt_1", robot_id=robot_id, job_id=job))
    with database.transaction() as session:
        assert fleet.cancel(session, "flt_1")
    assert given(settings)["kilter_jobs_ended_total", "cancelled", ""] == 1


def test_an_update_counts_the_jobs_that_are_there(database: Database, settings: Settings, robot_id: int) -> None:
    for number, (state, seconds) in enumerate((("succeeded", 2.0), ("succeeded", 8000.0), ("cancelled", None))):
        job = began(database, str(number), robot_id)
        at = utc_now()
        with database.transaction() as session:
            row = session.get_one(JobRow, job)
            row.state, row.finished_at = state, at
            row.started_at = None if seconds is None else at - timedelta(seconds=seconds)
    began(database, "waits", robot_id, None)
    command.downgrade(revision.configuration(database.url), "0016")
    revision.migrate(database)
    found = given(settings)
    assert found["kilter_jobs_ended_total", "succeeded", ""] == 2
    assert found["kilter_jobs_ended_total", "cancelled", ""] == 1
    assert found["kilter_job_duration_seconds_sum", "succeeded", ""] == pytest.approx(8002.0)
    told = [found["kilter_job_duration_seconds_bucket", "succeeded", edge] for edge in ("1.0", "2.5", "3600.0", "+Inf")]
    assert told == [0, 1, 1, 2]
    assert found["kilter_job_duration_seconds_count", "cancelled", ""] == 0
