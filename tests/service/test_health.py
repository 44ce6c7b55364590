from __future__ import annotations

import asyncio
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from kilter_service.ground.child_process import running
from kilter_service.ground.db import Database, revision
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import HeartbeatRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app
from kilter_service.web import health, store
from kilter_service.web import pulse as pulses
from kilter_service.web.auth.token import admin_token
from kilter_service.web.pulse import Pulse
from tests.service.forked import ForkedPopen
from tests.service.postgresql import own_postgresql, programs, running_postgresql

REPOSITORY = Path(__file__).resolve().parents[2]


def test_live_says_the_version(client: httpx.Client) -> None:
    assert client.get("/v1/health/live").json()["status"] == "live"


def beat(database: Database, process: str, name: str = "here", age_s: float = 0.0) -> None:
    with database.transaction() as session:
        session.merge(
            HeartbeatRow(process=process, name=name, pid=os.getpid(), at=utc_now() - timedelta(seconds=age_s))
        )


def why(client: httpx.Client) -> str:
    """What readiness says against itself."""
    answer = client.get("/v1/health/ready")
    assert answer.status_code == 503, answer.text
    assert answer.json()["code"] == "not_ready"
    assert client.get("/v1/health").json()["status"] == "not_ready"
    return str(answer.json()["detail"])


def test_ready_needs_a_worker(client: httpx.Client, database: Database) -> None:
    assert "kilterd worker" in why(client)
    beat(database, "worker")
    assert client.get("/v1/health/ready").json()["status"] == "ready"
    with database.transaction() as session:
        store.silence(session, "worker", "here")
    assert client.get("/v1/health").json()["status"] == "not_ready"


@pytest.mark.parametrize("process", ["worker", "corrector", "ros2"])
def test_who_speaks_from_the_future_is_not_alive(client: httpx.Client, database: Database, process: str) -> None:
    beat(database, "worker")
    beat(database, process, age_s=-3600.0)
    assert "s in the future: set the clocks" in why(client)


def test_killed_workers_do_not_count_beside_one_that_lives(client: httpx.Client, database: Database) -> None:
    beat(database, "worker", "killed", age_s=60.0)
    assert "kilterd worker" in why(client)
    beat(database, "worker")
    assert client.get("/v1/health/ready").json()["checks"]["worker"]["detail"] == "1 alive"


@pytest.mark.parametrize("process", ["corrector", "ros2"])
def test_one_that_fell_silent_is_missed_until_it_stops_by_itself(
    client: httpx.Client, database: Database, process: str
) -> None:
    beat(database, "worker")
    assert client.get("/v1/health/ready").json()["checks"][process] == {"ok": True, "detail": "none was started"}
    beat(database, process, "local", age_s=60.0)
    assert f"{process}: local last spoke 60 s ago" in why(client)
    assert f"kilterd {process}" in why(client)
    beat(database, process, "local")
    assert client.get("/v1/health/ready").status_code == 200
    with database.transaction() as session:
        store.silence(session, process, "local")
    assert client.get("/v1/health/ready").status_code == 200


def test_one_that_never_spoke_is_missed_where_kilterd_serve_runs_it(
    client: httpx.Client, database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    beat(database, "worker")
    monkeypatch.setenv(health.BESIDE, "worker,corrector")
    assert "corrector: has not spoken yet" in why(client)


def test_one_that_has_not_spoken_since_the_server_began_is_starting(
    client: httpx.Client, database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also beside what a server that was killed left in the database; for as long as a start may take."""
    monkeypatch.setenv(health.BESIDE, "worker,corrector")
    monkeypatch.setenv(health.BEGAN, str(time.monotonic() - 40.0))
    beat(database, "worker")
    beat(database, "corrector", "local", age_s=60.0)
    assert re.search(r"corrector: is starting, for 4\d s", why(client))
    beat(database, "corrector", "local", age_s=30.0)
    assert re.search(r"local last spoke 3\d s ago", why(client))
    with database.transaction() as session:
        store.silence(session, "worker", "here")
        store.silence(session, "corrector", "local")
    assert re.search(r"worker: is starting, for 4\d s; corrector: is starting", why(client))
    monkeypatch.setenv(health.BEGAN, str(time.monotonic() - health.LONGEST_START_S - 1.0))
    assert "corrector: has not spoken yet" in why(client)


def test_a_full_disk_is_told(client: httpx.Client, database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    beat(database, "worker")
    monkeypatch.setattr(health, "LEAST_FREE_MB", 1 << 40)
    assert "make room in" in why(client)


@pytest.mark.skipif(programs() is None, reason="PostgreSQL is not installed")
def test_a_database_that_is_away_is_a_finding_and_no_failure(settings: Settings, serve: Callable[..., Any]) -> None:
    with running_postgresql() as url:
        away = settings.model_copy(update={"database_url": url})
        database = Database(away.database)
        revision.migrate(database)
        client = serve(create_app(away))
        client.headers["Authorization"] = f"Bearer {admin_token(away)}"
        beat(database, "worker")
        database.close()
        assert client.get("/v1/health/ready").status_code == 200
    said = why(client)
    assert "database: cannot be read" in said
    assert "KILTER_DATABASE_URL" in said
    assert client.get("/v1/health").json()["checks"]["disk"]["ok"]
    assert client.get("/v1/health/live").status_code == 200


@pytest.mark.skipif(programs() is None, reason="PostgreSQL is not installed")
def test_a_database_that_hangs_is_a_finding_though_every_other_request_waits_for_it(
    settings: Settings, serve: Callable[..., Any], until: Callable[..., None]
) -> None:
    with own_postgresql() as server:
        hanging = settings.model_copy(update={"database_url": server.url})
        database = Database(hanging.database)
        revision.migrate(database)
        client = serve(create_app(hanging))
        client.headers["Authorization"] = f"Bearer {admin_token(hanging)}"
        beat(database, "worker")
        database.close()
        assert client.get("/v1/robots").status_code == 200
        with ThreadPoolExecutor(60) as pool, server.frozen():
            waiting = [pool.submit(client.get, "/v1/robots", timeout=60) for _ in range(60)]
            assert "database: cannot be read" in why(client)
        assert {one.result().status_code for one in waiting} <= {200, 503}
        until(lambda: client.get("/v1/health/ready").status_code == 200)


def test_a_database_of_another_revision_is_refused_with_the_remedy(settings: Settings) -> None:
    app = create_app(settings)

    async def start() -> None:
        async with app.router.lifespan_context(app):
            pass

    with pytest.raises(ServiceError, match="kilterd migrate"):
        asyncio.run(start())


def spoken(database: Database, process: str) -> list[store.Heartbeat]:
    with database.reading() as session:
        return store.heartbeats(session, process)


def test_a_pulse_beats_while_the_process_is_well(
    settings: Settings, database: Database, until: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pulses, "BEAT_S", 0.05)
    well = True
    with Pulse(settings, "corrector", "local", lambda: well):
        until(lambda: bool(spoken(database, "corrector")))
        well = False
        until(lambda: spoken(database, "corrector")[0].age_s > 0.5)
        well = True
        until(lambda: spoken(database, "corrector")[0].age_s < 0.5)
    assert not spoken(database, "corrector")


def test_a_loop_that_is_stuck_has_no_pulse(
    settings: Settings, database: Database, until: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pulses, "BEAT_S", 0.05)
    monkeypatch.setattr(pulses, "STUCK_S", 0.3)
    with Pulse(settings, "corrector", "local") as pulse:
        until(lambda: bool(spoken(database, "corrector")) and spoken(database, "corrector")[0].age_s > 0.6)
        pulse.round()
        until(lambda: spoken(database, "corrector")[0].age_s < 0.5)


@pytest.fixture
def sleeper() -> Iterator[int]:
    with subprocess.Popen([sys.executable, "-c", "import sys; sys.stdin.read()"], stdin=subprocess.PIPE) as process:
        yield process.pid
        process.kill()


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="this system does not tell")
def test_a_stopped_process_does_not_run(sleeper: int, until: Callable[..., None]) -> None:
    assert running(sleeper)
    os.kill(sleeper, signal.SIGSTOP)
    until(lambda: not running(sleeper))
    os.kill(sleeper, signal.SIGCONT)
    until(lambda: running(sleeper))


def test_a_corrector_that_is_stopped_from_outside_is_missed(
    settings: Settings,
    database: Database,
    client: httpx.Client,
    until: Callable[..., None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(health, "SILENT_AFTER_S", 4.0)
    environment = {**os.environ, **settings.environment()}
    command = [sys.executable, "-m", "kilter_service", "corrector"]
    found = lambda: client.get("/v1/health").json()["checks"]["corrector"]  # noqa: E731
    with ForkedPopen(command, env=environment, cwd=REPOSITORY) as process:
        try:
            until(lambda: bool(spoken(database, "corrector")))
            assert found()["ok"]
            os.kill(process.pid, signal.SIGSTOP)
            until(lambda: not found()["ok"])
            os.kill(process.pid, signal.SIGCONT)
            until(lambda: found()["detail"] == "1 alive")
            process.terminate()
            assert process.wait(30) == 0
        finally:
            process.kill()
    assert found() == {"ok": True, "detail": "none was started"}
