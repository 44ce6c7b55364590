"""Fixtures of the service: a data folder, a migrated database, and the application served over a real socket."""

from __future__ import annotations

import os
import shutil
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import httpx
import numpy as np
import pytest
import uvicorn
from fastapi import FastAPI
from sqlalchemy import make_url

from kilter_service.ground.db import Database, revision
from kilter_service.ground.db.tables import HeartbeatRow
from kilter_service.ground.settings import DATABASE_FILE, Settings
from kilter_service.run.app import create_app
from kilter_service.run.serving import KEEP_ALIVE_S
from kilter_service.web.auth.token import admin_token
from tests.service.forked import ForkedPopen, forked_worker
from tests.service.postgresql import database_of, programs, running_postgresql
from tests.service.prompt_server import PromptServer

REPOSITORY = Path(__file__).resolve().parents[2]
Serve = Callable[[FastAPI], httpx.Client]

# The same tests run on PostgreSQL when this names a server on which databases may be created.
POSTGRESQL = os.environ.get("KILTER_TEST_POSTGRESQL")


@contextmanager
def new_database() -> Iterator[str | None]:
    """Return the URL of an empty PostgreSQL database, or None where the tests run on SQLite."""
    if POSTGRESQL is None:
        yield None
        return
    with database_of(POSTGRESQL) as url:
        yield url


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run what is marked `both_databases` on SQLite and on PostgreSQL."""
    if metafunc.definition.get_closest_marker("both_databases") is not None and "backend" in metafunc.fixturenames:
        metafunc.parametrize("backend", ["sqlite", "postgresql"])


@pytest.fixture
def backend() -> str:
    """Return on which database a test runs."""
    return "sqlite"


@pytest.fixture(scope="session")
def postgresql() -> Iterator[str]:
    """URL of a PostgreSQL server for all tests."""
    if programs() is None:
        pytest.skip("no PostgreSQL server is installed: apt-get install postgresql")
    with running_postgresql() as url:
        yield url


@pytest.fixture(scope="session")
def postgresql_template(postgresql: str) -> Iterator[str]:
    """Name of a migrated database to copy: migrating takes longer than most tests."""
    with database_of(postgresql) as url:
        database = Database(url)
        revision.migrate(database)
        database.close()
        yield str(make_url(url).database)


@pytest.fixture
def settings(
    request: pytest.FixtureRequest, backend: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Settings]:
    for name in Settings.model_fields:
        monkeypatch.delenv(f"KILTER_{name.upper()}", raising=False)
    place = new_database()
    if backend == "postgresql":
        template = request.getfixturevalue("postgresql_template")
        place = database_of(request.getfixturevalue("postgresql"), template)
    with place as url:
        yield Settings(data=tmp_path / "data", database_url=url, port=0, zenoh_listen="tcp/127.0.0.1:0")


@pytest.fixture(scope="session")
def migrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a migrated SQLite file to copy: migrating takes longer than most tests."""
    path = tmp_path_factory.mktemp("migrated") / "kilter.sqlite"
    database = Database(f"sqlite:///{path}")
    revision.migrate(database)
    database.close()
    return path


@pytest.fixture
def database(settings: Settings, migrated: Path) -> Iterator[Database]:
    ready(settings, migrated)
    database = Database(settings.database)
    yield database
    database.close()


def ready(settings: Settings, migrated: Path) -> None:
    """Give the settings a migrated database."""
    settings.data.mkdir(parents=True, exist_ok=True)
    if settings.database_url is None:
        shutil.copy(migrated, settings.data / DATABASE_FILE)
        return
    database = Database(settings.database)
    revision.migrate(database)
    database.close()


@contextmanager
def served(app: FastAPI, **config: Any) -> Iterator[httpx.Client]:
    """Serve the application on a free port in a thread of this process."""
    listener = socket.create_server(("127.0.0.1", 0))
    kept = {"timeout_keep_alive": KEEP_ALIVE_S, "timeout_graceful_shutdown": 2, **config}
    server = PromptServer(uvicorn.Config(app, log_level="error", **kept))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    deadline = time.monotonic() + 10
    while not server.started and thread.is_alive() and time.monotonic() < deadline:
        time.sleep(0.005)
    assert server.started
    try:
        url = f"http://127.0.0.1:{listener.getsockname()[1]}"
        with httpx.Client(base_url=url, timeout=120) as client:
            yield client
    finally:
        server.ask_to_end()
        thread.join(10)
        listener.close()
        assert not thread.is_alive()


@pytest.fixture
def serve() -> Iterator[Serve]:
    """Serve any number of applications; all stop with the test."""
    running = []

    def start(app: FastAPI) -> httpx.Client:
        context = served(app)
        running.append(context)
        return context.__enter__()

    yield start
    for context in running:
        context.__exit__(None, None, None)


@pytest.fixture
def client(settings: Settings, database: Database, serve: Serve) -> httpx.Client:
    """Kilter's own application, with the admin token in the client's headers."""
    client = serve(create_app(settings))
    client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
    return client


@pytest.fixture(scope="module")
def shared_settings(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Iterator[Settings]:
    """A data folder and a migrated database for all tests of a module that do not care what the others left there."""
    with new_database() as url:
        settings = Settings(data=tmp_path_factory.mktemp("shared"), database_url=url, host="127.0.0.1", token=None)
        ready(settings, migrated)
        yield settings


@pytest.fixture(scope="module")
def shared_database(shared_settings: Settings) -> Iterator[Database]:
    database = Database(shared_settings.database)
    yield database
    database.close()


@pytest.fixture(scope="module")
def shared_client(shared_settings: Settings) -> Iterator[httpx.Client]:
    """One application for all tests of a module."""
    with served(create_app(shared_settings)) as client:
        client.headers["Authorization"] = f"Bearer {admin_token(shared_settings)}"
        yield client


class WorkerProcess:
    """`kilterd worker` as a process of its own."""

    def __init__(self, settings: Settings, database: Database) -> None:
        self._settings, self._database = settings, database
        self.process: ForkedPopen | None = None

    def start(self) -> None:
        """Start it and wait until it says that it is alive."""
        self.process = forked_worker({**os.environ, **self._settings.environment()}, REPOSITORY)
        wait_for(lambda: self._beats() or self.process is None or self.process.poll() is not None)
        assert self._beats()

    def _beats(self) -> bool:
        with self._database.transaction() as session:
            rows = session.query(HeartbeatRow).all()
            return any(self.process is not None and row.pid == self.process.pid for row in rows)

    def kill(self) -> None:
        """End it as a power cut would."""
        if self.process is not None:
            self.process.kill()
            self.process.wait(10)
            self.process = None

    def stop(self) -> int:
        """Ask it to stop; returns its exit code."""
        assert self.process is not None
        self.process.terminate()
        code, self.process = self.process.wait(10), None
        return int(code)


@pytest.fixture
def worker(settings: Settings, database: Database) -> Iterator[WorkerProcess]:
    """Return a worker that is not started yet."""
    worker = WorkerProcess(settings, database)
    yield worker
    worker.kill()


def wait_for(condition: Callable[[], bool], seconds: float = 180.0) -> None:
    """Wait until something is so."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)


class Katana:
    """A simulated Katana 450: its robot document and campaigns as JSON columns."""

    name = "katana"
    document: ClassVar[dict[str, Any]] = {"name": "katana", "convention": "preset", "preset": "katana450-chapter5"}

    def columns(self, rows: int, seed: int = 0, noise_m: float = 1e-5) -> dict[str, list[float]]:
        """Measure random poses."""
        from kilter_core.twin import thesis_katana

        twin = thesis_katana()
        limits = twin.robot.limits
        q = np.random.default_rng(seed).uniform(limits[:, 0], limits[:, 1], (rows, twin.robot.n_joints))
        found = twin.observe(q, noise_m=noise_m, seed=seed)
        assert found.position is not None
        out = {f"q{j + 1}_deg": np.degrees(q[:, j]).tolist() for j in range(q.shape[1])}
        return out | {f"{axis}_mm": (found.position[:, k] * 1e3).tolist() for k, axis in enumerate("xyz")}

    def campaign(self, client: httpx.Client, rows: int, seed: int = 0) -> str:
        """Upload random poses as a new campaign; returns its id."""
        client.post("/v1/robots", json=self.document).raise_for_status()
        answer = client.post(
            f"/v1/robots/{self.name}/campaigns", json={"name": f"seed {seed}", "numbered": True}
        ).raise_for_status()
        campaign = str(answer.json()["id"])
        client.post(f"/v1/campaigns/{campaign}/observations", json=self.columns(rows, seed)).raise_for_status()
        return campaign


@pytest.fixture
def katana() -> Katana:
    return Katana()


@pytest.fixture
def until() -> Callable[..., None]:
    return wait_for
