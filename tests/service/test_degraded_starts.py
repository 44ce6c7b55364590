"""A part that is missing at the start does not take the arm's correction with it, and is named."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import httpx
import pytest

from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.run.supervisor import MOST_ENDS
from tests.service.conftest import wait_for
from tests.service.forked import KILTERD, ForkedPopen, children_of
from tests.service.made_versions import store_version
from tests.service.test_compensation import add
from tests.service.test_serve import REPOSITORY, Server, children


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of its own with 12 MB of room."""
    place = tmp_path / "small"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=12m", "tmpfs", str(place)]
    if subprocess.run(command, check=False, capture_output=True).returncode != 0:
        pytest.skip("this account may not mount a disk")
    yield place
    subprocess.run(["umount", "--lazy", str(place)], check=True)


def test_a_nearly_full_disk_and_a_worker_that_can_never_run_are_named_and_setpoints_are_corrected(
    settings: Settings, small_disk: Path
) -> None:
    """One start was never ready, and after 300 s the corrector was ended with all the rest, without a word about the disk.

    The worker ends at every start, and what it says last is in the ready line: health says only that it is starting.
    """
    if settings.database_url is not None:
        pytest.skip("the database is not on that disk, and the worker's lock is beside another one")
    lock = small_disk / "data" / "kilter.sqlite.worker.lock"
    lock.mkdir(parents=True)
    server = Server(settings.model_copy(update={"data": small_disk / "data"}), ForkedPopen)
    try:
        missing = server.ready["missing"]
        assert missing.keys() == {"disk", "worker"}
        assert "200 MB are needed: make room in" in missing["disk"]
        assert missing["worker"].startswith("ended with 1 (")
        assert f"{lock}" in missing["worker"]
        assert "times in a row. Mend what it says" in missing["worker"]
        assert server.ready["zenoh"].startswith("tcp/127.0.0.1:")
        assert children_of(server.process.pid).keys() >= {"api", "corrector"}
        lock.rmdir()  # the remedy: it starts by itself
        wait_for(lambda: missing_of(server.ready["url"]) == {"disk"})
        assert children_of(server.process.pid).keys() == {"api", "worker", "corrector"}
    finally:
        assert server.stop() == 0
        assert server.process.stdout is not None
        server.process.stdout.close()


def missing_of(url: str) -> set[str]:
    checks = httpx.get(f"{url}/v1/health", timeout=10).json()["checks"]
    return {name for name, check in checks.items() if not check["ok"]}


def test_a_worker_that_ends_again_and_again_at_the_start_ends_nothing_else(settings: Settings) -> None:
    environment = {**os.environ, **settings.environment()}
    process = ForkedPopen([*KILTERD, "serve"], env=environment, cwd=REPOSITORY, stdout=subprocess.PIPE)
    watch = threading.Timer(90, process.kill)
    watch.start()
    try:
        killed: list[int] = []
        while len(killed) <= MOST_ENDS and process.poll() is None:
            with suppress(OSError):  # it ended while it was looked at
                worker = children_of(process.pid).get("worker")
                if worker is not None and worker not in killed:
                    os.kill(worker, signal.SIGKILL)
                    killed.append(worker)
            time.sleep(0.01)
        assert process.stdout is not None
        ready = json.loads(process.stdout.readline() or b"{}")
        assert ready.get("zenoh", "").startswith("tcp/127.0.0.1:")
    finally:
        watch.cancel()
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 0
        assert process.stdout is not None
        process.stdout.close()


def test_an_api_that_can_never_run_does_not_end_the_stream_that_an_arm_follows(
    settings: Settings, client: httpx.Client, database: Database, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server above the stream was killed and started again: its stream process went on alone meanwhile."""
    add(client, "arm")  # a stream that corrects nobody does not go on
    client.post(f"/v1/versions/{store_version(database, 'arm', 1)}/activate").raise_for_status()
    first = Server(settings, ForkedPopen)
    stream = json.loads(settings.corrector_file.read_text())["endpoints"]["stream"]
    first.process.kill()
    first.process.wait()
    assert first.process.stdout is not None
    first.process.stdout.close()
    (tmp_path / "sitecustomize.py").write_text(
        "import sys\nif 'api' in sys.orig_argv: raise SystemExit('no room for the API')\n"
    )
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [str(tmp_path), os.environ.get("PYTHONPATH", "")])))
    server = Server(settings)
    try:
        assert server.ready["zenoh"] == stream
        assert server.ready["missing"].keys() == {"api"}
        assert server.ready["missing"]["api"].startswith("ended with 1 (SystemExit: no room for the API), ")
        assert server.process.poll() is None
        assert "corrector" in children(server.process.pid)
    finally:
        assert server.stop() == 0
        assert server.process.stdout is not None
        server.process.stdout.close()
