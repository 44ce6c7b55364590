"""The live view where the corrector is behind TLS and access control, and where it runs on another machine than the API."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from kilter_client.stream import CorrectedStream
from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app
from kilter_service.web.auth.token import admin_token
from tests.page.controlling import HOME, CorrectorProcess
from tests.service.conftest import REPOSITORY, ready, served, wait_for
from tests.service.made_versions import store_version

pytestmark = pytest.mark.slow
ROBOT = {"name": "katana", "convention": "preset", "preset": "katana450-chapter5"}


@contextmanager
def serving(settings: Settings, version: bool = True) -> Iterator[httpx.Client]:
    """The API of these settings, with a robot and its active version."""
    with served(create_app(settings)) as client:
        client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
        if version:
            client.post("/v1/robots", json=ROBOT).raise_for_status()
            database = Database(settings.database)
            made = store_version(database, "katana", 1)
            database.close()
            client.post(f"/v1/versions/{made}/activate", json={"force": True}).raise_for_status()
        yield client


def told(client: httpx.Client, seconds: float = 1.5) -> list[dict[str, Any]]:
    """What a page hears within so many seconds."""
    heard, end = [], time.monotonic() + seconds
    with client.stream("GET", "/robots/katana/stream/events", timeout=30) as answer:
        assert answer.status_code == 200, answer.read()
        for line in answer.iter_lines():
            if line.startswith("data: "):
                heard.append(json.loads(line.removeprefix("data: ")))
            if time.monotonic() > end:
                break
    return heard


def streams_of(client: httpx.Client) -> dict[str, dict[str, Any]]:
    return {one["name"]: one for one in told(client)[-1]["streams"]}


def zenoh_config(settings: Settings) -> Path:
    """TLS and access control as the how-to says to write them; returns the folder of all roles."""
    command = [
        sys.executable,
        "-m",
        "kilter_service",
        "zenoh-config",
        "--data",
        str(settings.data),
        "--host",
        "127.0.0.1",
    ]
    environment = os.environ | settings.environment()
    done = subprocess.run(command, cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return settings.data / "zenoh"


def test_a_stream_behind_tls_and_access_control_is_shown(tmp_path: Path, migrated: Path) -> None:
    plain = Settings(data=tmp_path / "data", port=0, zenoh_listen="tcp/127.0.0.1:0", host="127.0.0.1")
    ready(plain, migrated)
    roles = zenoh_config(plain)
    guarded = {"zenoh_listen": "tls/127.0.0.1:0", "zenoh_config": roles / "corrector" / "zenoh.json5"}
    settings = plain.model_copy(update=guarded)
    corrector = CorrectorProcess(settings)
    with serving(settings) as client:
        corrector.start()
        try:
            with CorrectedStream(
                "katana", data=settings.data, stream="guarded", deadline_s=0.5, connect_timeout_s=30.0, signed=True,
                zenoh_config=roles / "controller-main" / "zenoh.json5",
            ) as stream:  # fmt: skip
                wait_for(lambda: stream.correct(HOME).source == "corrected")
                wait_for(lambda: stream.correct(HOME).source == "corrected" and "guarded" in streams_of(client))
            shown = streams_of(client)["guarded"]
            assert shown["signed"]
            assert shown["corrected"] > 0
            assert told(client)[-1]["reach"] == "connected"
        finally:
            corrector.stop()


def test_a_corrector_on_another_machine_is_told_of_by_the_database(tmp_path: Path, migrated: Path) -> None:
    there = Settings(
        data=tmp_path / "there",
        database_url=f"sqlite:///{tmp_path}/kilter.sqlite",
        port=0,
        zenoh_listen="tcp/127.0.0.1:0",
        host="127.0.0.1",
    )
    here = there.model_copy(update={"data": tmp_path / "here"})
    ready(there, migrated)
    corrector = CorrectorProcess(there)
    with serving(there), serving(here, version=False) as client:
        assert told(client)[-1]["reach"] in ("away", "connecting")
        corrector.start()
        try:
            with CorrectedStream(
                "katana", data=there.data, stream="far", deadline_s=0.5, connect_timeout_s=30.0
            ) as stream:

                def shown() -> tuple[str, int]:
                    """Where the corrector is said to be, and how many setpoints it has had."""
                    for _ in range(5):
                        stream.correct(HOME)
                    last = told(client, 5.0)[-1]  # a corrector of this machine is waited for three seconds
                    return last["reach"], sum(one["received"] for one in last["streams"] if one["name"] == "far")

                wait_for(lambda: shown() > ("elsewhere", 0), 60.0)
                before = shown()[1]
                wait_for(lambda: shown()[1] > before, 60.0)
            assert "does not answer" not in told(client, 5.0)[-1]["bypass"]
        finally:
            corrector.stop()
