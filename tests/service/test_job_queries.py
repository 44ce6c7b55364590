"""Lists of jobs and the question whether one waits read an index: a server has hundred thousands of jobs that are over."""

from __future__ import annotations

from collections.abc import Callable
from datetime import timedelta
from typing import Any

import pytest
from sqlalchemy import event, insert, text

from kilter_service.ground.db import Database, Session
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import JobRow, RobotRow
from kilter_service.ground.paging import Page
from kilter_service.jobs import store
from kilter_service.jobs.work import store as lease

JOBS, ROBOTS, WAITING = 8_000, 40, 3


@pytest.fixture
def full(database: Database) -> Database:
    """A database with many jobs, of which few are not over, and whose planner knows it."""
    begun = utc_now()
    robots = [{"id": k, "name": f"r{k}", "document": {}, "left_out": []} for k in range(1, ROBOTS + 1)]
    jobs = [
        {"id": f"job_{k:016x}", "kind": "identify", "robot_id": 1 + k % ROBOTS, "request": {"robot": f"r{k % ROBOTS}"},
         "state": "queued" if k >= JOBS - WAITING else "succeeded", "created_at": begun + timedelta(seconds=k // 3)}
        for k in range(JOBS)
    ]  # fmt: skip
    with database.transaction() as session:
        session.execute(insert(RobotRow), robots)
        session.execute(insert(JobRow), jobs)
    with database.transaction() as session:
        session.execute(text("ANALYZE"))
    return database


def plan(database: Database, ask: Callable[[Session], Any]) -> str:
    """How the database reads the jobs that a question is about."""
    seen: list[tuple[str, Any]] = []

    def note(_c: Any, _cursor: Any, statement: str, parameters: Any, *_: Any) -> None:
        seen.append((statement, parameters))

    event.listen(database.engine, "before_cursor_execute", note)
    try:
        with database.reading() as session:
            ask(session)
    finally:
        event.remove(database.engine, "before_cursor_execute", note)
    statement, parameters = next(one for one in seen if "FROM jobs" in one[0])
    words = "EXPLAIN QUERY PLAN" if database.url.startswith("sqlite") else "EXPLAIN"
    with database.engine.connect() as connection:
        return "\n".join(str(row[-1]) for row in connection.exec_driver_sql(f"{words} {statement}", parameters))


@pytest.mark.both_databases
def test_questions_about_jobs_read_an_index(full: Database) -> None:
    with full.reading() as session:
        last = store.newest_jobs(session, None, Page(100))[-1]
    second = Page(100, (last.created_at.isoformat(), last.id))
    expected: dict[str, Callable[[Session], Any]] = {
        "ix_jobs_newest ": lambda session: store.newest_jobs(session, None, Page(100)),
        "ix_jobs_newest": lambda session: store.newest_jobs(session, None, second),
        "ix_jobs_newest_of_robot": lambda session: store.newest_jobs(session, "r5", Page(100)),
    }
    for index, ask in expected.items():
        found = plan(full, ask)
        assert index.strip() in found, found
        assert "Seq Scan" not in found, found
        assert "TEMP B-TREE FOR ORDER BY" not in found, found  # not all of them are sorted
    for waiting in (WAITING, 0):
        found = plan(full, lambda session: session.execute(lease.query_for_free_jobs(["identify", "gap"], "w")))
        assert "ix_jobs_not_over" in found or "ix_jobs_state" in found, found
        with full.transaction() as session:
            assert (lease.claim(session, "w", ["identify"]) is not None) == bool(waiting)
            session.execute(text("UPDATE jobs SET state = 'succeeded'"))


def test_pages_hold_every_job_once(full: Database) -> None:
    """Three jobs have one moment each: a page may end between them."""
    seen: list[str] = []
    page = Page(1000)
    while True:
        with full.reading() as session:
            found = store.newest_jobs(session, None, page)
        shown, cursor = page.cut(found, lambda job: (job.created_at.isoformat(), job.id))
        seen += [job.id for job in shown]
        if cursor is None:
            break
        page = Page(1000, (shown[-1].created_at.isoformat(), shown[-1].id))
    assert len(seen) == len(set(seen)) == JOBS
