"""A server for a while: `kilterd serve` as a child process with its own data folder and free ports on loopback."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

START_DEADLINE_S = 150.0  # the first start after a change compiles the kernels
STOP_DEADLINE_S = 20.0
POLL_S = 0.05

Start = Callable[..., subprocess.Popen[bytes]]


@dataclass(frozen=True)
class LocalServer:
    """Where a started server is: its URL, its zenoh endpoint and its data folder."""

    url: str
    zenoh: str
    data: Path

    def environment(self) -> dict[str, str]:
        """Return this process's environment with what a client needs to find the server and this program's commands."""
        commands = str(Path(sys.executable).parent)
        return os.environ | {
            "KILTER_DATA": str(self.data),
            "KILTER_URL": self.url,
            "PATH": commands + os.pathsep + os.environ.get("PATH", ""),
        }


@contextmanager
def local_server(data: Path, start: Start = subprocess.Popen) -> Iterator[LocalServer]:
    """Start a server on free loopback ports and stop it by its handle afterwards; its log is ``data/server.log``."""
    command = [sys.executable, "-m", "kilter_service", "serve", "--port", "0"]
    plain = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
    environment = plain | {"KILTER_DATA": str(data), "KILTER_ZENOH_LISTEN": "tcp/127.0.0.1:0"}
    data.mkdir(parents=True, exist_ok=True)
    with (data / "server.log").open("wb") as log:
        process = start(command, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        try:
            yield _wait_until_ready(process, data)
        finally:
            _stop(process)


def _wait_until_ready(process: subprocess.Popen[bytes], data: Path) -> LocalServer:
    deadline = time.monotonic() + START_DEADLINE_S
    file = data / "server.json"
    while time.monotonic() < deadline:
        if process.poll() is not None:
            raise RuntimeError(f"kilterd ended with {process.returncode}; its log:\n{_log(data)}")
        if file.exists():
            document = json.loads(file.read_text())
            return LocalServer(document["url"], document["zenoh"], data)
        time.sleep(POLL_S)
    raise RuntimeError(f"kilterd was not ready after {START_DEADLINE_S:.0f} s; its log:\n{_log(data)}")


def _log(data: Path) -> str:
    return (data / "server.log").read_text(errors="replace")[-4000:]


def _stop(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(STOP_DEADLINE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
