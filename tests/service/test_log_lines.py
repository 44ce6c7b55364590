"""Logs from outside: every line of a server is JSON where that is asked for, and a rotation loses no line."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from kilter_service.ground import child_process
from kilter_service.ground.settings import Settings
from kilter_service.web.auth.token import admin_token
from tests.service.forked import ForkedPopen, children_of, forked_command

REPOSITORY = Path(__file__).resolve().parents[2]
ROTATION = REPOSITORY / "deploy" / "logrotate" / "kilter"
LOGROTATE = shutil.which("logrotate", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
TURNS, SENDERS = 5, 4
Until = Callable[..., None]


@contextmanager
def running(command: str, settings: Settings, log: Path, **more: str) -> Iterator[tuple[ForkedPopen, str]]:
    """A process of Kilter whose standard error goes to a file, and its address."""
    environment = {**os.environ, **settings.environment(), **more}
    arguments = [sys.executable, "-m", "kilter_service", command]
    with log.open("wb") as file:
        process = ForkedPopen(arguments, env=environment, cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=file)
    assert process.stdout is not None
    with process:
        try:
            yield process, json.loads(process.stdout.readline() or b"{}").get("url", "")
        finally:
            process.terminate()
            process.wait(30)


def test_every_line_is_json_whatever_happens_to_the_processes(settings: Settings, until: Until, tmp_path: Path) -> None:
    settings = settings.model_copy(update={"log_format": "json", "access_log": "-"})
    log = tmp_path / "log"
    with running("serve", settings, log) as (server, url):
        headers = {"Authorization": f"Bearer {admin_token(settings)}"}
        with httpx.Client(base_url=url, headers=headers, timeout=60, trust_env=False) as client:
            client.post("/v1/robots", json={"name": "arm", "convention": "preset", "preset": "ur10"}).raise_for_status()
            until(lambda: "POST /v1/robots 201" in log.read_text())  # or the API is killed before it writes the line
            for name in ("worker", "api"):
                os.kill(children_of(server.pid)[name], signal.SIGKILL)
            until(lambda: all(f"{name} " in log.read_text() for name in ("worker", "api")))
            until(lambda: ready(client))
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    assert all({"time", "level", "logger", "process", "message"} <= line.keys() for line in lines)
    assert {"serve", "api", "worker", "corrector"} <= {line["process"] for line in lines}
    (asked,) = [line for line in lines if line["message"].startswith("POST /v1/robots ")]
    assert (asked["message"], asked["client"], asked["process"]) == ("POST /v1/robots 201", "127.0.0.1", "api")


def ready(client: httpx.Client) -> bool:
    try:
        return client.get("/v1/health/ready").status_code == 200
    except httpx.TransportError:
        return False


def test_a_command_that_cannot_go_on_says_so_in_json(settings: Settings, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        told = settings.model_copy(update={"log_format": "json", "port": port})
        with running("serve", told, tmp_path / "log") as (server, _):
            assert server.wait(60) == 2
    lines = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    assert str(port) in lines[-1]["message"]


def test_warnings_and_what_nobody_caught_are_lines_too(tmp_path: Path) -> None:
    code = """
import threading, warnings
from kilter_service.web import logs
from kilter_service.ground.settings import Settings
from tests.service.forked import ForkedPopen, children_of, forked_command
logs.configure(Settings(log_format="json"), "api")
warnings.warn("kernels cannot be kept")
thread = threading.Thread(target=lambda: {}["a"], name="watcher")
thread.start(); thread.join()
raise RuntimeError("nobody foresaw this")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    warned, thread, end = [json.loads(line) for line in done.stderr.splitlines()]
    assert "kernels cannot be kept" in warned["message"]
    assert (thread["message"], "KeyError" in thread["exception"]) == ("the thread watcher ends", True)
    assert end["exception"].endswith("RuntimeError: nobody foresaw this")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("kilterd: The port is taken.", "The port is taken."),
        ('{"level": "ERROR", "message": "The port is taken."}', "The port is taken."),
        ('{"message": "the process ends", "exception": "Traceback\\n  at x\\nValueError: no"}', "ValueError: no"),
        ('{"of": "something else"}', '{"of": "something else"}'),
        ("{cut off", "{cut off"),
    ],
)
def test_the_last_line_of_a_process_is_a_sentence(line: str, said: str) -> None:
    code = f"import sys; sys.stderr.write({line!r})"
    with subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE) as process:
        words = child_process.ChildOutput("worker")
        words.follow(process.stderr)
        process.wait(30)
        words.close()
        assert words.last_line() == said


@pytest.mark.skipif(LOGROTATE is None, reason="logrotate is not installed: apt-get install logrotate")
def test_a_rotation_of_the_access_log_loses_no_request(settings: Settings, until: Until, tmp_path: Path) -> None:
    folder = tmp_path / "kilter"
    folder.mkdir(mode=0o700)
    settings = settings.model_copy(update={"access_log": str(folder / "access.log")})
    rules = tmp_path / "rules"
    rules.write_text(ROTATION.read_text(encoding="utf-8").replace("/var/log/kilter/", f"{folder}/"), encoding="utf-8")
    rules.chmod(0o600)
    sent, stop = Counter[str](), threading.Event()
    prepare = forked_command("migrate", environment={**os.environ, **settings.environment()}, folder=REPOSITORY)
    assert prepare.returncode == 0
    with running("api", settings, tmp_path / "log") as (_, url):

        def send(sender: int) -> None:
            with httpx.Client(base_url=url, timeout=60, trust_env=False) as client:
                for number in range(100_000):
                    if stop.is_set():
                        return
                    name = f"r{sender}-{number}"
                    client.get("/v1/health/live", headers={"X-Request-ID": name}).raise_for_status()
                    sent[name] += 1

        senders = [threading.Thread(target=send, args=(number,)) for number in range(SENDERS)]
        for thread in senders:
            thread.start()
        try:
            for _ in range(TURNS):
                enough = len(sent) + 40
                until(lambda least=enough: len(sent) >= least)
                rotate = [str(LOGROTATE), "--force", "--state", str(tmp_path / "state"), str(rules)]
                done = subprocess.run(rotate, capture_output=True, text=True, timeout=60, check=False)
                assert (done.returncode, done.stderr) == (0, "")
            enough = len(sent) + 40
            until(lambda: len(sent) >= enough)
        finally:
            stop.set()
            for thread in senders:
                thread.join(60)
    assert len(list(folder.iterdir())) == TURNS + 1
    assert Counter(lines_of(folder)) == sent


def lines_of(folder: Path) -> Iterator[str]:
    """Names of the requests in all files of the access log."""
    for file in folder.iterdir():
        content: Any = file.read_bytes()
        if file.suffix == ".gz":
            content = subprocess.run(
                ["gzip", "--decompress", "--stdout", str(file)], capture_output=True, check=True
            ).stdout
        for line in content.decode().splitlines():
            yield json.loads(line)["request_id"]
