"""`kilterd serve` from outside: its processes are real, and so are the ways they end."""

from __future__ import annotations

import json
import os
import signal
import ssl
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest

from kilter_service.ground.settings import Settings
from kilter_service.run import supervisor
from tests.service.forked import forked_command

REPOSITORY = Path(__file__).resolve().parents[2]
Until = Callable[..., None]


def alive(pid: int) -> bool:
    try:
        # A child that was killed and not yet reaped by init is dead all the same.
        return "Z" not in Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0]
    except OSError:
        return False


def children(pid: int) -> dict[str, int]:
    """Process ids of the supervisor's children by command."""
    found = {}
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split():
        command = Path(f"/proc/{child}/cmdline").read_bytes().split(b"\0")
        if b"kilter_service" in command[:-1]:
            found[command[command.index(b"kilter_service") + 1].decode()] = int(child)
    return found


class Server:
    """A server in a process of its own, and its ready line."""

    def __init__(self, settings: Settings, start: Callable[..., subprocess.Popen[bytes]] = subprocess.Popen) -> None:
        environment = {**os.environ, **settings.environment()}
        command = [sys.executable, "-m", "kilter_service", "serve"]
        self.process = start(command, env=environment, cwd=REPOSITORY, stdout=subprocess.PIPE)
        watch = threading.Timer(90, self.process.kill)
        watch.start()
        assert self.process.stdout is not None
        self.ready: dict[str, Any] = json.loads(self.process.stdout.readline() or b"{}")
        watch.cancel()

    def stop(self) -> int:
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(20)


@pytest.fixture
def server(settings: Settings) -> Iterator[Server]:
    server = Server(settings)
    yield server
    if server.process.poll() is None:
        server.process.kill()
        server.process.wait()
    if server.process.stdout is not None:
        server.process.stdout.close()


def test_serve_is_ready_survives_kill_9_of_its_processes_and_stops_clean(
    server: Server, settings: Settings, until: Until
) -> None:
    url = server.ready["url"]
    assert json.loads(settings.server_file.read_text()) == server.ready
    assert server.ready["pid"] == server.process.pid
    assert server.ready["zenoh"].startswith("tcp/127.0.0.1:")
    assert not server.ready["zenoh"].endswith(":0")
    assert httpx.get(f"{url}/v1/health/ready", timeout=60).json()["status"] == "ready"
    assert oct(settings.token_file.stat().st_mode)[-3:] == "600"

    before = children(server.process.pid)
    assert set(before) == {"api", "worker", "corrector"}
    for name in ("api", "worker"):
        os.kill(before[name], signal.SIGKILL)
    until(lambda: {"api", "worker"} <= set(children(server.process.pid)))
    until(lambda: not set(before.values()) & {children(server.process.pid).get(name) for name in ("api", "worker")})
    # The socket belongs to the supervisor: a request waits for the new API process instead of failing.
    assert httpx.get(f"{url}/v1/health/live", timeout=30).status_code == 200

    second = run("serve", **settings.environment())
    assert second.returncode == 1
    assert "A server runs in" in second.stderr

    last = children(server.process.pid)
    assert server.stop() == 0
    assert not any(alive(pid) for pid in last.values())
    assert not settings.server_file.exists()
    assert not settings.corrector_file.exists()


def test_a_page_that_follows_a_stream_does_not_hold_a_stop_up(settings: Settings, tmp_path: Path) -> None:
    with (tmp_path / "stderr.txt").open("wb") as log:
        server = Server(settings, partial(subprocess.Popen, stderr=log))
        try:
            token = settings.token_file.read_text().strip()
            with httpx.Client(
                base_url=server.ready["url"], headers={"Authorization": f"Bearer {token}"}, timeout=60
            ) as http:
                http.post(
                    "/v1/robots", json={"name": "shown", "convention": "preset", "preset": "katana450-chapter4"}
                ).raise_for_status()
                with http.stream("GET", "/robots/shown/stream/events") as events:
                    lines = events.iter_lines()
                    assert next(line for line in lines if line.startswith("event"))
                    assert server.stop() == 0
                    assert "event: refused" not in list(lines)  # the body ends as it should: no broken connection
        finally:
            server.process.kill()
            server.process.wait()
            assert server.process.stdout is not None
            server.process.stdout.close()
    said = (tmp_path / "stderr.txt").read_text()
    assert "Traceback" not in said
    assert "ERROR" not in said.upper().replace("ERRORS", "")


def test_processes_end_when_the_supervisor_is_killed(settings: Settings, until: Until) -> None:
    environment = {**os.environ, **settings.environment()}
    supervisor = subprocess.Popen([sys.executable, "-m", "kilter_service", "serve"], env=environment, cwd=REPOSITORY)
    try:
        until(lambda: set(children(supervisor.pid)) == {"api", "worker", "corrector"})
        left = children(supervisor.pid)
    finally:
        supervisor.kill()
        supervisor.wait()
    until(lambda: not any(alive(pid) for pid in left.values()), seconds=30)


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return forked_command(*arguments, environment={**os.environ, **environment}, folder=REPOSITORY)


def test_usage_errors_exit_2_and_name_the_remedy(tmp_path: Path) -> None:
    data = str(tmp_path / "data")
    wide = run("serve", "--data", data, "--host", "0.0.0.0", "--port", "0")
    assert (wide.returncode, "KILTER_TOKEN" in wide.stderr) == (2, True)
    port = run("serve", "--data", data, "--port", "70000")
    assert (port.returncode, "kilterd: --port: " in port.stderr) == (2, True)
    for name, value in (("KILTER_PORT", "many"), ("KILTER_ZENOH_LISTEN", "")):
        done = run("serve", "--data", data, **{name: value})
        assert (done.returncode, f"kilterd: {name}: " in done.stderr) == (2, True), done.stderr
    assert run("paint").returncode == 2


def test_help_has_an_example_for_every_command() -> None:
    for command in ("serve", "api", "worker", "corrector", "ros2", "migrate", "backup", "restore", "verify", "doctor"):
        assert "Example: " in run(command, "--help").stdout


def test_migrate_says_what_it_did(tmp_path: Path) -> None:
    assert "was brought to revision" in run("migrate", KILTER_DATA=str(tmp_path)).stdout
    assert "is at revision" in run("migrate", KILTER_DATA=str(tmp_path)).stdout


def test_an_api_without_its_tables_says_so_in_one_sentence(tmp_path: Path) -> None:
    settings = {"KILTER_DATA": str(tmp_path), "KILTER_PORT": "0"}
    refused = run("api", **settings)
    assert (refused.returncode, refused.stdout) == (1, "")
    assert refused.stderr.startswith("kilterd: The database is at revision none, this Kilter needs ")
    assert "run `kilterd migrate`" in refused.stderr
    assert refused.stderr.count("\n") == 1
    assert run("migrate", **settings).returncode == 0
    command = [sys.executable, "-m", "kilter_service", "api"]
    with subprocess.Popen(
        command, env={**os.environ, **settings}, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True
    ) as api:
        assert api.stdout is not None
        url = json.loads(api.stdout.readline())["url"]
        assert httpx.get(f"{url}/v1/health/live", timeout=60.0).status_code == 200
        api.terminate()


def test_asking_whether_it_is_ready_reads_no_certificates(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is asked twenty times a second while the others start, and certificates take 50 ms."""
    read: list[str] = []
    monkeypatch.setattr(ssl.SSLContext, "load_default_certs", lambda *_: read.append("certificates"))
    assert supervisor._missing("http://127.0.0.1:1") is None
    assert read == []
