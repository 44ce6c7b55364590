"""Fixtures of the service: a data folder, a migrated database, and the application served over a real socket."""

from __future__ import annotations

import shutil
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
import uvicorn
from fastapi import FastAPI

from service.app import create_app
from service.auth.token import admin_token
from service.db import Database, revision
from service.settings import DATABASE_FILE, Settings

Serve = Callable[[FastAPI], httpx.Client]


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Settings:
    for name in Settings.model_fields:
        monkeypatch.delenv(f"KILTER_{name.upper()}", raising=False)
    return Settings(data=tmp_path / "data", port=0, zenoh_listen="tcp/127.0.0.1:0")


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
    settings.data.mkdir(parents=True)
    shutil.copy(migrated, settings.data / DATABASE_FILE)
    database = Database(settings.database)
    yield database
    database.close()


@contextmanager
def served(app: FastAPI) -> Iterator[httpx.Client]:
    """Serve the application on a free port in a thread of this process."""
    listener = socket.create_server(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(app, log_level="error", timeout_graceful_shutdown=2))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    deadline = time.monotonic() + 10
    while not server.started and thread.is_alive() and time.monotonic() < deadline:
        time.sleep(0.005)
    assert server.started
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{listener.getsockname()[1]}", timeout=30) as client:
            yield client
    finally:
        server.should_exit = True
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
