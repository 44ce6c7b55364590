"""The wall clock of the machine is set while a server works: nothing is lost, done twice or silent for long.

The clock is set for the processes of the server and of a controller beside it, by a library that is loaded before all others
and adds to the time of day. libfaketime does more: with it `time.sleep` fails (EINVAL) and fits take minutes.
"""

from __future__ import annotations

import json
import os
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx
import pytest

from kilter_client import Kilter
from kilter_service.ground.settings import Settings
from kilter_service.run.backup import service as backups
from kilter_service.web.auth.token import admin_token
from kilter_service.web.health import SetClock
from tests.service.conftest import Katana, ready
from tests.service.preloaded import preloaded

REPOSITORY = Path(__file__).resolve().parents[2]
HOUR, DAY = 3600, 86400
ROWS = 40
CONTROLLER = """
import sys, time
from pathlib import Path
from kilter_client.stream import CorrectedStream
with CorrectedStream("katana", data=Path(sys.argv[1]), stream="clock", deadline_s=5.0, settled=True,
                     connect_timeout_s=60.0) as stream:
    while True:
        given = stream.correct([0.1, 0.6, 0.4, 0.3, 0.2])
        print(given.source, given.status, flush=True)
        time.sleep(0.02)
"""


class World:
    """A server and a controller on a machine whose clock is set, and somebody who measures all the time."""

    def __init__(self, settings: Settings, folder: Path, library: Path) -> None:
        self.settings, self.clock = settings, folder / "clock"
        self.clock.write_bytes(bytes(8))
        loaded = {"LD_PRELOAD": str(library), "TEST_CLOCK": str(self.clock)}
        self._environment = {**os.environ, **settings.environment(), **loaded}
        self._log = (folder / "log").open("ab")
        self._processes: list[subprocess.Popen[bytes]] = []
        server = self.start("-m", "kilter_service", "serve")
        assert server.stdout is not None
        self.url = json.loads(server.stdout.readline() or b"{}")["url"]
        self.token = admin_token(settings)
        self.http = self.client(self.token)
        self.sources: list[str] = []
        self._end = threading.Event()
        self._threads: list[threading.Thread] = []
        self.stored: list[tuple[str, int]] = []

    def set(self, by_s: int) -> None:
        """Set the clock to so many seconds beside the right time."""
        with self.clock.open("r+b", buffering=0) as file:
            file.write(struct.pack("l", by_s))

    def start(self, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, *arguments]
        self._processes.append(
            subprocess.Popen(command, env=self._environment, cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=self._log)
        )
        return self._processes[-1]

    def client(self, token: str) -> httpx.Client:
        return httpx.Client(base_url=self.url, headers={"Authorization": f"Bearer {token}"}, timeout=60)

    def work(self) -> None:
        """Begin to stream and to upload."""
        for task in (self._listen, self._measure):
            self._threads.append(threading.Thread(target=task))
            self._threads[-1].start()

    def _listen(self) -> None:
        controller = self.start("-c", CONTROLLER, str(self.settings.data))
        assert controller.stdout is not None
        for line in controller.stdout:
            self.sources.append(line.decode().strip())

    def _measure(self) -> None:
        """Each request is sent twice under its key, as when the answer was lost."""
        with self.client(self.token) as http:
            while not self._end.wait(0.05):
                k = len(self.stored)
                made = twice(http, "/v1/robots/katana/campaigns", f"campaign-{k}", {"name": f"number {k:03d}"})
                sent = twice(http, f"/v1/campaigns/{made['id']}/observations", f"rows-{k}", Katana().columns(ROWS, k))
                self.stored.append((made["id"], sent["rows"]))

    def job(self) -> str:
        """Ask for a version."""
        body = {"kind": "identify", "robot": "katana", "campaigns": [self.first], "options": {"level": 1}}
        return str(self.http.post("/v1/jobs", json=body).raise_for_status().json()["id"])

    def over(self, job: str) -> dict[str, Any]:
        """Wait for the end of a job."""
        while True:
            found: dict[str, Any] = self.http.get(f"/v1/jobs/{job}").raise_for_status().json()
            if found["state"] not in ("queued", "running"):
                return found
            time.sleep(0.02)

    def prepare(self) -> None:
        """A robot with an active version, which the stream follows."""
        self.http.post("/v1/robots", json=Katana.document).raise_for_status()
        made = self.http.post("/v1/robots/katana/campaigns", json={"name": "first"}).raise_for_status().json()
        self.first = str(made["id"])
        rows = Katana().columns(ROWS, 1000)
        self.http.post(f"/v1/campaigns/{self.first}/observations", json=rows).raise_for_status()
        version = self.over(self.job())["result"]["version_id"]
        self.http.post(f"/v1/versions/{version}/activate", json={}).raise_for_status()

    def stop(self) -> None:
        """End everything in order."""
        self._end.set()
        self.http.close()
        for process in reversed(self._processes):
            process.send_signal(signal.SIGTERM)
            process.wait(30)
        for thread in self._threads:
            thread.join(30)
        for process in self._processes:
            if process.stdout is not None:
                process.stdout.close()
        self._log.close()


def twice(http: httpx.Client, path: str, key: str, body: dict[str, Any]) -> dict[str, Any]:
    """Send a request twice under one key; both answers are the same."""
    first, again = (http.post(path, json=body, headers={"Idempotency-Key": key}) for _ in range(2))
    assert first.status_code == 201, first.text
    assert first.json() == again.json()
    return dict(first.json())


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return preloaded("clock", tmp_path_factory.mktemp("clock"))


@pytest.fixture
def world(settings: Settings, migrated: Path, library: Path, tmp_path: Path) -> Iterator[World]:
    ready(settings, migrated)
    world = World(settings, tmp_path, library)
    yield world
    world.stop()


def healthy(world: World, seconds: float) -> set[str]:
    """What health says of worker and corrector, which must be well all the time."""
    said, end = set(), time.monotonic() + seconds
    while time.monotonic() < end:
        found = world.http.get("/v1/health").json()
        assert found["status"] == "ready", found
        said |= {found["checks"][name]["detail"] for name in ("worker", "corrector")}
        time.sleep(0.1)
    return said


def set_and_look(world: World, by_s: int, until: Callable[..., None], seconds: float = 4.0) -> None:
    """Set the clock while jobs run: all goes on, and health says that it was set."""
    jobs, streamed, stored = [world.job() for _ in range(2)], len(world.sources), len(world.stored)
    world.set(by_s)
    jobs += [world.job()]
    said = healthy(world, seconds)
    assert any("the clock was just set" in one for one in said), said
    until(lambda: len(world.stored) > stored + 1 and len(world.sources) > streamed + 20, seconds=25)
    for job in jobs:
        done = world.over(job)
        assert done["state"] == "succeeded", done
        assert datetime.fromisoformat(done["finished_at"]) >= datetime.fromisoformat(done["started_at"])
    versions = [world.http.get(f"/v1/jobs/{job}").json()["result"]["version_id"] for job in jobs]
    listed = [one["id"] for one in world.http.get("/v1/robots/katana/versions").json()["versions"]]
    assert sorted(listed[: len(jobs)]) == sorted(versions)  # newest first, whatever the clock said
    latest = world.http.get("/v1/resolve", params={"kind": "version", "reference": "latest", "robot": "katana"})
    assert latest.json()["id"] == versions[-1], latest.text


def whole(world: World) -> None:
    """All that was acknowledged is there once, in its order, and the audit is whole."""
    world._end.set()
    world._threads[-1].join(60)
    assert not world._threads[-1].is_alive()
    found = world.http.get("/v1/robots/katana/campaigns", params={"limit": 1000}).json()["campaigns"]
    assert [(one["id"], one["rows"]) for one in found] == [(world.first, ROWS), *world.stored]
    others = [one for one in world.sources if one != "corrected OK"]
    assert others in ([], ["held STALE"], 2 * ["held STALE"]), (
        others
    )  # a busy machine may keep a frame, whatever its clock says
    with Kilter(world.url, token=world.token) as kilter:
        assert kilter.verify_audit()["entries"] > len(found)
    backups.restore(elsewhere(world), backups.backup(world.settings, world.settings.data.parent / "all.backup")[0])


def elsewhere(world: World) -> Settings:
    """An empty data folder."""
    return world.settings.model_copy(update={"data": world.settings.data.parent / "restored"})


def test_a_clock_that_is_set_a_day_ahead_and_back(world: World, until: Callable[..., None]) -> None:
    world.prepare()
    made = world.http.post("/v1/tokens", json={"name": "visitor", "role": "viewer", "days": 1}).json()
    login = httpx.post(f"{world.url}/login", data={"token": world.token}, timeout=60)
    page = httpx.Client(base_url=world.url, cookies=login.cookies, timeout=60)
    world.work()
    until(lambda: bool(world.sources and world.stored), seconds=25)
    with world.client(made["token"]) as limited, page:
        for by_s, token, actor in ((DAY, 401, "anybody"), (0, 200, "admin")):
            set_and_look(world, by_s, until, 1.2)
            assert limited.get("/v1/robots").status_code == token
            assert page.get("/v1/whoami").json()["actor"] == actor
    whole(world)


@pytest.mark.slow
@pytest.mark.parametrize("by_s", [-DAY, -HOUR, HOUR, 30 * DAY])
def test_a_clock_that_is_set(world: World, until: Callable[..., None], by_s: int) -> None:
    world.prepare()
    world.work()
    until(lambda: bool(world.sources and world.stored), seconds=25)
    set_and_look(world, by_s, until)
    set_and_look(world, 0, until)
    whole(world)


def test_how_far_a_clock_was_set_is_forgotten_after_a_while() -> None:
    clock, steady = [1000.0], [5.0]
    watched = SetClock(10.0, lambda: clock[0], lambda: steady[0])

    def after(seconds: float, set_by: float = 0.0) -> list[float]:
        clock[0] += seconds + set_by
        steady[0] += seconds
        return watched.sets_s()

    assert after(3600.0, 0.5) == []
    assert after(1.0, DAY) == [DAY]
    assert after(2.0, -HOUR) == [DAY - HOUR, -HOUR]
    assert after(9.0) == [-HOUR]
    assert after(9.0) == []
