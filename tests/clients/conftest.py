"""A whole server for the client's tests: `kilterd serve` on free ports, found through its data folder."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from kilter_client import Kilter
from tests.clients.test_cli import Command
from tests.service.forked import ForkedPopen

READY_S = 120


@contextmanager
def server_in(data: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run `kilterd serve` on free ports until the block ends."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
    environment |= {"KILTER_DATA": str(data), "KILTER_PORT": "0", "KILTER_ZENOH_LISTEN": "tcp/127.0.0.1:0"}
    with (data / "log").open("ab") as log:
        process = ForkedPopen(
            [sys.executable, "-m", "kilter_service", "serve"],
            env=environment,
            stdout=log,
            stderr=log,
            stdin=subprocess.DEVNULL,
        )
        try:
            deadline = time.monotonic() + READY_S
            while not (data / "server.json").exists() or _pid(data) != process.pid:
                assert process.poll() is None, (data / "log").read_text()
                assert time.monotonic() < deadline, (data / "log").read_text()
                time.sleep(0.05)
            yield process
        finally:
            process.terminate()
            process.wait(30)


def _pid(data: Path) -> int:
    try:
        return int(json.loads((data / "server.json").read_text())["pid"])
    except (OSError, ValueError):
        return 0


@pytest.fixture(scope="session")
def server_data(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Data folder of a running server."""
    data = tmp_path_factory.mktemp("kilter")
    with server_in(data):
        yield data


@pytest.fixture
def no_settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Neither environment nor home folder of whoever runs the tests says where a server is."""
    for name in ("KILTER_URL", "KILTER_TOKEN", "KILTER_DATA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str]) -> Command:
    """``kilter`` in this process."""
    return Command(capsys)


@pytest.fixture
def k(server: Path) -> Iterator[Kilter]:
    """The library, connected to the running server."""
    with Kilter() as connected:
        yield connected


@pytest.fixture
def server(server_data: Path, no_settings: None, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The running server, found as a person's own: by KILTER_DATA."""
    monkeypatch.setenv("KILTER_DATA", str(server_data))
    return server_data


@pytest.fixture
def kilter(server: Path) -> Iterator[Kilter]:
    """A connected client."""
    with Kilter() as client:
        yield client


@pytest.fixture
def robot(kilter: Kilter, request: pytest.FixtureRequest) -> str:
    """A Katana 450 of this test's own."""
    name = request.node.name.replace("[", ".").replace("]", "").replace(" ", "-")[:60]
    kilter.robots.add({"name": name, "convention": "preset", "preset": "katana450-chapter4"})
    return name


WriteCampaign = Callable[..., Path]


@pytest.fixture
def write_campaign(tmp_path: Path) -> WriteCampaign:
    """Writer of simulated measurements in contract columns."""
    from kilter_core.arm.documents import robot_from_document
    from kilter_core.arm.presets import preset_document
    from kilter_core.twin import Twin

    def write(poses: int = 40, name: str = "measured.csv", seed: int = 1) -> Path:
        robot = robot_from_document(preset_document("katana450-chapter4"))
        low, high = (np.array([getattr(joint, side) for joint in robot.joints]) for side in ("lower", "upper"))
        q = np.random.default_rng(seed).uniform(0.8 * low, 0.8 * high, (poses, len(low)))
        found = Twin(robot, {"theta_offset_2": 2e-3, "theta_offset_3": -1e-3}).observe(q, noise_m=1e-5, seed=seed)
        assert found.position is not None
        head = [f"q{i + 1}_deg" for i in range(len(low))] + ["x_mm", "y_mm", "z_mm"]
        table = np.hstack([np.degrees(found.q), found.position * 1e3])
        path = tmp_path / name
        np.savetxt(path, table, delimiter=",", header=",".join(head), comments="", fmt="%.12g")
        return path

    return write
