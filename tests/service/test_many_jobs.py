"""1000 small jobs on four workers and two APIs, counted: `tools.lab many-jobs` prints how long each took and what it stores."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import func, select, text

from kilter_service.ground.db.tables import JobRow, VersionRow
from tests.service.conftest import Katana, wait_for
from tests.service.postgresql import PostgreSql
from tests.service.test_workers import Fleet, server

__all__ = ["server"]  # the fixture

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]

JOBS = int(os.environ.get("JOBS", "1000"))
WORKERS = 4
KILLED = 2  # while they compute; others take their place


@pytest.fixture
def fleet(server: PostgreSql, tmp_path: Path) -> Iterator[Fleet]:
    made = Fleet(server, tmp_path, Katana(), wait_for)
    try:
        yield made
    finally:
        made.close()


def test_a_thousand_jobs_make_a_thousand_versions(fleet: Fleet) -> None:
    campaign = fleet.katana.campaign(fleet.apis[0], 40)
    begun = time.monotonic()
    jobs = [fleet.submit(campaign, options={"level": 1}) for _ in range(JOBS)]
    submitted = time.monotonic() - begun
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begun = time.monotonic()
    for _ in range(WORKERS):
        fleet.worker()
    for share in range(1, KILLED + 1):
        wait_for(lambda share=share: _over(fleet) >= share * JOBS // 4, seconds=3000)  # type: ignore[misc]
        fleet.workers[share - 1].kill()
        fleet.worker()
    wait_for(lambda: _over(fleet) == JOBS, seconds=3000)
    took = time.monotonic() - begun
    with fleet.database.reading() as session:
        ended = {state: n for state, n in session.execute(select(JobRow.state, func.count()).group_by(JobRow.state))}  # noqa: C416
        versions = set(session.execute(select(VersionRow.job_id)).scalars())
        again = session.execute(select(func.count()).where(JobRow.attempts > 1)).scalar_one()
        sizes = {
            table: session.execute(text(f"SELECT pg_total_relation_size('{table}')")).scalar_one() // JOBS
            for table in ("jobs", "versions")
        }
    for one in fleet.workers:
        if one.process is not None:
            assert one.stop() == 0
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(f"\n{JOBS} jobs: submitted in {submitted:.1f} s, computed in {took:.1f} s, {again} twice")
    print(f"{used / JOBS * 1e3:.0f} ms of processor time for each, starts of workers included; bytes for each: {sizes}")
    assert ended == {"succeeded": JOBS}
    assert versions == set(jobs)
    assert again <= KILLED * 2


def _over(fleet: Fleet) -> int:
    with fleet.database.reading() as session:
        return session.execute(select(func.count()).where(JobRow.state == "succeeded")).scalar_one()
