"""Several workers and several API processes on one PostgreSQL, what ends them, and the one worker of SQLite."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import func, select

from kilter_service.ground.db import Database, revision
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import HeartbeatRow, JobRow, VersionRow
from kilter_service.ground.settings import Settings
from kilter_service.jobs.work import store
from kilter_service.jobs.work import worker as workers
from kilter_service.jobs.work.runner import Runner
from kilter_service.jobs.work.store import Claim
from kilter_service.jobs.work.worker import Watch
from kilter_service.run.app import create_app
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import WorkerProcess, served
from tests.service.forked import forked_command
from tests.service.postgresql import PostgreSql, own_postgresql, programs

REPOSITORY = Path(__file__).resolve().parents[2]
Until = Callable[..., None]
# Minutes of work that tell their progress at every fold.
LONG = {"validation": {"folds": 190}, "options": {"level": 3}}
FINAL = ("succeeded", "failed", "cancelled")


@pytest.fixture(scope="module")
def server() -> Iterator[PostgreSql]:
    """A PostgreSQL server that the tests may stop and start."""
    if programs() is None:
        pytest.skip("no PostgreSQL server is installed: apt-get install postgresql")
    with own_postgresql() as running:
        database = Database(running.url)
        revision.migrate(database)
        database.close()
        yield running


class Fleet:
    """Two API applications and some workers on one database."""

    def __init__(self, server: PostgreSql, folder: Path, katana: Any, until: Until) -> None:
        self.server, self.folder, self.katana, self.until = server, folder, katana, until
        self.database = Database(server.url)
        self._open = ExitStack()
        self.apis = [self._api(name) for name in ("one", "two")]
        self.workers: list[WorkerProcess] = []

    def settings(self, name: str) -> Settings:
        return Settings(data=self.folder / name, database_url=self.server.url, port=0, worker_name="same")

    def _api(self, name: str) -> httpx.Client:
        settings = self.settings(name)
        client = self._open.enter_context(served(create_app(settings)))
        client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
        return client

    def worker(self) -> WorkerProcess:
        started = WorkerProcess(self.settings("worker"), self.database)
        self.workers.append(started)
        started.start()
        return started

    def submit(self, campaign: str, **job: Any) -> str:
        asked = {"kind": "identify", "robot": "katana", "campaigns": [campaign], **job}
        return str(self.apis[0].post("/v1/jobs", json=asked).raise_for_status().json()["id"])

    def get(self, job: str, api: int = 1) -> dict[str, Any]:
        found: dict[str, Any] = self.apis[api].get(f"/v1/jobs/{job}").raise_for_status().json()
        return found

    def running(self, job: str) -> str:
        """Wait until a job computes; returns the id of its worker."""
        self.until(lambda: self.get(job)["state"] in FINAL or "fold" in self.get(job)["progress"]["stage"], seconds=120)
        assert self.get(job)["state"] == "running", self.get(job)
        with self.database.reading() as session:
            return session.get_one(JobRow, job).worker

    def owner(self, job: str) -> WorkerProcess:
        """The process that runs a job."""
        name = self.running(job)
        with self.database.reading() as session:
            pid = session.execute(select(HeartbeatRow.pid).where(HeartbeatRow.name == name)).scalar_one()
        return next(one for one in self.workers if one.process is not None and one.process.pid == pid)

    def versions_of(self, job: str) -> int:
        with self.database.reading() as session:
            counted = select(func.count()).select_from(VersionRow).where(VersionRow.job_id == job)
            return session.execute(counted).scalar_one()

    def close(self) -> None:
        for one in self.workers:
            one.kill()
        self._open.close()
        self.database.close()


@pytest.fixture(scope="module")
def fleet(server: PostgreSql, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """Two APIs and two workers of one name."""
    from tests.service.conftest import Katana, wait_for

    fleet = Fleet(server, tmp_path_factory.mktemp("fleet"), Katana(), wait_for)
    try:
        fleet.worker()
        fleet.worker()
        yield fleet
    finally:
        fleet.close()


@pytest.fixture(scope="module")
def campaign(fleet: Fleet) -> str:
    """Uploaded at one API."""
    return str(fleet.katana.campaign(fleet.apis[1], 200))


def test_another_worker_finishes_the_job_of_a_killed_one(fleet: Fleet, campaign: str) -> None:
    """The two have one name, as on machines set up from one image."""
    job = fleet.submit(campaign, validation={"folds": 12}, options={"level": 3})
    fleet.owner(job).kill()
    fleet.until(lambda: fleet.get(job)["attempts"] == 2)  # after 15 s of silence, on a machine that is not busy
    fleet.until(lambda: fleet.get(job)["state"] in FINAL)
    done = fleet.get(job)
    assert done["state"] == "succeeded", done
    assert fleet.versions_of(job) == 1
    with fleet.database.reading() as session:
        assert len(store.beats(session)) == 1  # that of the dead one is gone


def test_a_job_is_cancelled_at_another_api_and_even_when_its_worker_is_dead(fleet: Fleet, campaign: str) -> None:
    job = fleet.submit(campaign, **LONG)
    frozen = fleet.owner(job).process
    assert frozen is not None
    os.kill(frozen.pid, signal.SIGSTOP)  # as good as dead, and it comes back
    try:
        answer = fleet.apis[1].post(f"/v1/jobs/{job}/cancel")
        assert (answer.status_code, answer.json()["state"]) == (200, "cancelled")
        with fleet.apis[1].stream("GET", f"/v1/jobs/{job}/events") as events:
            assert any("event: end" in line for line in events.iter_lines())
    finally:
        os.kill(frozen.pid, signal.SIGCONT)
    next_one = fleet.submit(campaign, options={"level": 1})
    fleet.until(lambda: fleet.get(next_one)["state"] in FINAL)
    assert fleet.get(next_one)["state"] == "succeeded"
    assert fleet.get(job)["state"] == "cancelled"
    assert fleet.versions_of(job) == 0


def test_postgresql_restarts_in_the_middle_and_nothing_is_lost(fleet: Fleet, campaign: str) -> None:
    running = fleet.submit(campaign, validation={"folds": 30}, options={"level": 3})
    waiting = fleet.submit(campaign, options={"level": 1})
    fleet.running(running)
    fleet.server.stop()
    try:
        for answer in (fleet.apis[0].get(f"/v1/jobs/{running}"), fleet.apis[1].post(f"/v1/jobs/{running}/cancel")):
            assert (answer.status_code, answer.json()["code"]) == (503, "database_away")
            assert "send it again" in answer.json()["detail"]
            assert answer.headers["retry-after"]
    finally:
        fleet.server.start()
    fleet.until(lambda: all(fleet.get(job)["state"] in FINAL for job in (running, waiting)))
    assert [fleet.get(job)["state"] for job in (running, waiting)] == ["succeeded", "succeeded"]
    assert fleet.get(running)["attempts"] == 1  # it went on computing
    assert [fleet.versions_of(job) for job in (running, waiting)] == [1, 1]
    assert all(one.process is None or one.process.poll() is None for one in fleet.workers)


def test_what_a_replaced_run_computed_is_dropped(client: httpx.Client, database: Database, katana: Any) -> None:
    """A worker that was thought dead comes back after another has taken its job, and after that one has finished."""
    first = _claimed(client, database, katana, "slow")
    slow, quick = Runner(database), Runner(database)
    outcome = slow._compute(first)
    with database.transaction() as session:
        assert store.orphans(session) == [first.job_id]
        assert store.orphans(session) == []  # a second sweep finds nothing
        second = store.claim(session, "quick", ["identify"])
    assert second == Claim(first.job_id, "quick", 2)
    slow._finish(first, outcome)
    assert client.get(f"/v1/jobs/{first.job_id}").json()["state"] == "running"
    quick.run(second)
    done = client.get(f"/v1/jobs/{first.job_id}").json()
    assert (done["state"], done["attempts"]) == ("succeeded", 2)
    slow._finish(first, outcome)
    quick.run(second)
    assert client.get(f"/v1/jobs/{first.job_id}").json() == done
    assert len(client.get("/v1/robots/katana/versions").json()["versions"]) == 1


def _claimed(client: httpx.Client, database: Database, katana: Any, worker: str) -> Claim:
    asked = {"kind": "identify", "robot": "katana", "campaigns": [katana.campaign(client, 60)], "options": {"level": 1}}
    job = client.post("/v1/jobs", json=asked).raise_for_status().json()["id"]
    with database.transaction() as session:
        claim = store.claim(session, worker, ["identify"])
    assert claim is not None
    assert claim.job_id == job
    return claim


def test_a_job_that_ends_ten_workers_fails(client: httpx.Client, database: Database, katana: Any) -> None:
    claim = _claimed(client, database, katana, "w1")
    with database.transaction() as session:
        for attempt in range(2, store.MAX_ATTEMPTS + 1):
            store.orphans(session)
            assert store.claim(session, f"w{attempt}", ["identify"]) == Claim(claim.job_id, f"w{attempt}", attempt)
        assert store.orphans(session) == [claim.job_id]
        assert store.claim(session, "w11", ["identify"]) is None
    failed = client.get(f"/v1/jobs/{claim.job_id}").json()
    assert failed["state"] == "failed"
    assert "died 10 times" in failed["error"]["message"]


def test_a_claim_whose_answer_was_lost_is_found_again(client: httpx.Client, database: Database, katana: Any) -> None:
    """The connection may break after the database has stored the claim: the worker runs nothing, the row says it does."""
    claim = _claimed(client, database, katana, "here")
    with database.transaction() as session:
        free = {name: store.query_for_free_jobs(["identify"], name) for name in ("there", "here")}
        assert session.execute(free["there"]).first() is None
        assert session.execute(free["here"]).first() is not None
        assert store.claim(session, "here", ["identify"]) == Claim(claim.job_id, "here", 2)
        assert not store.holds(session, claim)
        store.give_back(session, "here")
        assert store.claim(session, "there", ["gap"]) is None
        assert store.claim(session, "there", ["identify"]) == Claim(claim.job_id, "there", 3)


def test_silence_is_measured_by_the_own_clock() -> None:
    """Clocks of other machines may be wrong: what counts is that a heartbeat does not change."""
    time_s, ahead = 0.0, utc_now() + timedelta(days=1)
    watch = Watch(15.0, clock=lambda: time_s)
    beats = {"ahead": ahead, "behind": utc_now() - timedelta(days=1)}
    assert watch.silent(beats) == {}
    time_s = 14.0
    beats["behind"] += timedelta(seconds=1)
    assert watch.silent(beats) == {}
    time_s = 16.0
    assert watch.silent(beats) == {"ahead": ahead}
    watch.forget()  # the database was away: nobody could beat
    assert watch.silent(beats) == {}
    time_s = 40.0
    assert set(watch.silent(beats)) == {"ahead", "behind"}


def test_a_worker_of_older_code_ends_and_its_job_waits_for_the_next(
    client: httpx.Client, database: Database, katana: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    member = workers.Member(database, "old")
    member.join(alone=False)
    claim = _claimed(client, database, katana, member.id)
    member.beat()
    monkeypatch.setattr(revision, "HEAD", "older")
    monkeypatch.setattr(workers, "CHECK_S", 0.0)
    member._check_at = 0.0
    with pytest.raises(Exception, match="kilterd migrate"):
        member.beat()
    member.leave()
    with database.transaction() as session:
        assert store.claim(session, "new", ["identify"]) == Claim(claim.job_id, "new", 2)


def test_a_job_that_ran_under_an_older_kilter_starts_again(
    client: httpx.Client, database: Database, katana: Any
) -> None:
    """Before workers had ids, a running job named none."""
    claim = _claimed(client, database, katana, "")
    member = workers.Member(database, "new")
    member.join(alone=False)
    with database.transaction() as session:
        assert store.claim(session, member.id, ["identify"]) == Claim(claim.job_id, member.id, 2)


def test_sqlite_has_one_worker(settings: Settings, database: Database, worker: WorkerProcess, until: Until) -> None:
    worker.start()
    second = forked_command("worker", environment={**os.environ, **settings.environment()}, folder=REPOSITORY)
    assert second.returncode == 2
    assert "Another process runs the jobs of" in second.stderr
    assert "KILTER_DATABASE_URL" in second.stderr
    assert "Traceback" not in second.stderr
    worker.kill()
    worker.start()  # the lock ended with its process
    assert worker.stop() == 0


def test_a_missing_driver_is_said_with_the_remedy(tmp_path: Path) -> None:
    code = "import sys; sys.modules['psycopg'] = None\nfrom kilter_service.__main__ import main\nmain(['migrate'])"
    environment = {
        **os.environ,
        "KILTER_DATABASE_URL": "postgresql://nobody@127.0.0.1:1/x",
        "KILTER_DATA": str(tmp_path),
    }
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120, cwd=REPOSITORY
    )
    assert done.returncode == 1
    assert "pip install 'psycopg[binary]'" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_database_that_is_not_there_is_said_with_the_remedy(tmp_path: Path) -> None:
    environment = {
        **os.environ,
        "KILTER_DATABASE_URL": "postgresql://nobody@127.0.0.1:1/x",
        "KILTER_DATA": str(tmp_path),
    }
    done = forked_command("migrate", environment=environment, folder=REPOSITORY)
    assert done.returncode == 1
    assert "see that it runs" in done.stderr
    assert "Traceback" not in done.stderr
