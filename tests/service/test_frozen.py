"""Processes of a server that are frozen (SIGSTOP): it says so, the others go on, and it goes on or starts again."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest

from kilter_client.stream import CorrectedStream
from kilter_service.ground.child_process import is_process_stopped, running
from kilter_service.ground.settings import Settings
from kilter_service.run.backup.service import verify_stored
from kilter_service.run.supervisor import Program
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import Katana, ready
from tests.service.test_read_only_disk import Q, asked, finished, made
from tests.service.test_serve import children

Until = Callable[..., None]
REPOSITORY = Path(__file__).resolve().parents[2]


def test_the_supervisor_says_once_that_a_process_is_frozen(
    settings: Settings, until: Until, caplog: pytest.LogCaptureFixture
) -> None:
    child = Program("ros2", settings)
    said = lambda: [record.getMessage() for record in caplog.records]  # noqa: E731
    child._command = [sys.executable, "-c", "import sys; sys.stdin.read()"]
    child.start()
    pid = child.pid or 0
    try:
        os.kill(pid, signal.SIGSTOP)
        until(lambda: child.watch() or bool(said()))  # type: ignore[func-returns-value]
        child.watch()
        assert said() == [
            f"ros2 is frozen (SIGSTOP or a debugger): `kill -CONT {pid}` lets it go on, after `kill -KILL {pid}` it "
            "starts again"
        ]
        os.kill(pid, signal.SIGCONT)
        until(lambda: child.watch() or len(said()) > 1)  # type: ignore[func-returns-value]
        assert said()[1:] == ["ros2 goes on"]
        os.kill(pid, signal.SIGSTOP)
        until(lambda: child.watch() or len(said()) > 2)  # type: ignore[func-returns-value]
        os.kill(pid, signal.SIGKILL)  # as it says
        until(lambda: child.watch() or child.pid != pid)  # type: ignore[func-returns-value]
    finally:
        os.kill(child.pid or 0, signal.SIGKILL)
        child.wait(0.0)


class Frozen:
    """A server with an active version, and its messages."""

    def __init__(self, settings: Settings, log: Path) -> None:
        self.settings, self._log = settings, log
        environment = {**os.environ, **settings.environment()}
        with log.open("wb") as file:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "kilter_service", "serve"], env=environment, cwd=REPOSITORY,
                stdout=subprocess.PIPE, stderr=file,
            )  # fmt: skip
        assert self.process.stdout is not None
        self.process.stdout.readline()
        url = str(settings.server_file.read_text(encoding="utf-8").split('"')[3])
        token = admin_token(settings)
        self.http = httpx.Client(base_url=url, headers={"Authorization": f"Bearer {token}"}, timeout=60)

    def said(self) -> str:
        return self._log.read_text(encoding="utf-8")

    def why(self) -> str:
        """What health says against itself."""
        checks = self.http.get("/v1/health").json()["checks"]
        return "; ".join(f"{name}: {check['detail']}" for name, check in checks.items() if not check["ok"])

    def stop(self) -> None:
        self.http.close()
        self.process.terminate()
        assert self.process.wait(30) == 0
        assert self.process.stdout is not None
        self.process.stdout.close()


@pytest.fixture
def server(settings: Settings, migrated: Path, tmp_path: Path) -> Iterator[Frozen]:
    ready(settings, migrated)
    server = Frozen(settings, tmp_path / "log")
    yield server
    server.stop()


@pytest.mark.slow
def test_what_the_others_do_while_one_is_frozen(server: Frozen, settings: Settings, until: Until) -> None:
    http = server.http
    campaign = made(http)
    version = finished(http, asked(http, campaign).json()["id"], until)["result"]["version_id"]
    http.post(f"/v1/versions/{version}/activate", json={}).raise_for_status()
    pids = children(server.process.pid)
    with CorrectedStream("katana", data=settings.data, deadline_s=5.0, connect_timeout_s=60.0, settled=True) as line:
        # the worker: jobs wait, and are done once
        os.kill(pids["worker"], signal.SIGSTOP)
        jobs = [asked(http, campaign).json()["id"] for _ in range(3)]
        until(lambda: "worker: no worker spoke in the last 10 s" in server.why(), seconds=60)
        assert {http.get(f"/v1/jobs/{job}").json()["state"] for job in jobs} <= {"queued", "running"}
        os.kill(pids["worker"], signal.SIGCONT)
        assert {finished(http, job, until)["state"] for job in jobs} == {"succeeded"}
        # the corrector's first process: the stream goes on with the version in use
        os.kill(pids["corrector"], signal.SIGSTOP)
        until(lambda: "corrector: local last spoke" in server.why(), seconds=60)
        assert {line.correct(Q).source for _ in range(50)} == {"corrected"}
        os.kill(pids["corrector"], signal.SIGCONT)
        until(lambda: server.why() == "", seconds=60)
        # the API: requests wait for it, and the stream does not
        os.kill(pids["api"], signal.SIGSTOP)
        with pytest.raises(httpx.ReadTimeout):
            http.get("/v1/health/live", timeout=1.0)
        assert {line.correct(Q).source for _ in range(50)} == {"corrected"}
        until(lambda: "api is frozen" in server.said(), seconds=10)
        os.kill(pids["api"], signal.SIGKILL)  # as the message says: another one answers
        until(lambda: children(server.process.pid).get("api") not in (None, pids["api"]), seconds=30)
        added = http.post("/v1/robots", json=Katana.document | {"name": "later"}, timeout=60)
        assert added.status_code == 201
    # the supervisor: the others go on, and one that ends meanwhile starts again when it goes on
    os.kill(server.process.pid, signal.SIGSTOP)
    os.kill(pids["worker"], signal.SIGKILL)
    until(lambda: "worker: no worker spoke" in server.why(), seconds=60)
    assert asked(http, campaign).status_code == 202
    os.kill(server.process.pid, signal.SIGCONT)
    until(lambda: server.why() == "", seconds=60)
    for name in ("worker", "corrector", "api"):
        assert server.said().count(f"{name} is frozen") == 1
    assert verify_stored(settings).damaged == []


def test_a_process_whose_first_thread_has_ended_is_not_stopped() -> None:
    """As Linux shows a process that ends: its leader is a zombie while other threads still run."""
    code = (
        "import ctypes, threading, time; threading.Thread(target=time.sleep, args=(60,)).start(); "
        "print('there', flush=True); ctypes.CDLL(None).pthread_exit(None)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None
        process.stdout.readline()
        deadline = time.monotonic() + 20
        while running(process.pid) and time.monotonic() < deadline:
            time.sleep(0.02)
        assert process.poll() is None
        assert not running(process.pid)
        assert not is_process_stopped(process.pid)
    finally:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()
