"""Parts of a job on a real Dask cluster of this machine: the same numbers, whoever is killed, and clear words."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_core.errors import CancelledError, CoreError, OptionError
from kilter_core.identify import Folds, IdentifyOptions, identify
from kilter_core.twin import thesis_katana
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.jobs.fan_out import fan_out
from kilter_service.jobs.fan_out import spread as part
from kilter_service.jobs.work import store
from kilter_service.jobs.work.runner import Runner
from tests.blind.generator import cases
from tests.blind.run import run as benchmark
from tests.service.conftest import Katana
from tests.service.parts import killing, noted, recorded, where

# Not importorskip: each tester would import it, a second of processor time.
pytestmark = pytest.mark.skipif(find_spec("distributed") is None, reason="distributed is not installed")
REPOSITORY = Path(__file__).resolve().parents[2]


class Cluster:
    """A scheduler and its workers, each a process of its own."""

    def __init__(self, folder: Path, workers: int = 2, **environment: str) -> None:
        self._folder, self._stack = folder, ExitStack()
        self.scheduler = self._started(
            "dask_scheduler", "--port", "0", "--scheduler-file", str(folder / "scheduler"), **environment
        )
        until_written(folder / "scheduler")
        self.address = str(json.loads((folder / "scheduler").read_text())["address"])
        self.workers = [self.worker() for _ in range(workers)]

    def worker(self, **environment: str) -> subprocess.Popen[bytes]:
        return self._started(
            "dask_worker", self.address, "--no-nanny", "--nthreads", "1", "--local-directory", str(self._folder),
            **environment,
        )  # fmt: skip

    def close(self) -> None:
        self._stack.close()

    def _started(self, command: str, *options: str, **environment: str) -> subprocess.Popen[bytes]:
        place = {
            "PYTHONPATH": str(REPOSITORY), "DASK_TEMPORARY_DIRECTORY": str(self._folder),
            "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "2s",  # how long a worker that was killed is asked for its answers
        }  # fmt: skip
        process = subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{command}", "--host", "127.0.0.1", "--no-dashboard", *options],
            env={**os.environ, **place, **environment}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self._stack.callback(process.wait)
        self._stack.callback(process.kill)
        return process


def until_written(path: Path, wait_s: float = 60.0) -> None:
    ends = time.monotonic() + wait_s
    while not path.exists() or not path.read_text():
        assert time.monotonic() < ends
        time.sleep(0.05)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    started = Cluster(tmp_path_factory.mktemp("dask"))
    try:
        yield started
    finally:
        started.close()


def test_parts_are_computed_by_the_workers_of_the_cluster(cluster: Cluster) -> None:
    found = set(fan_out(1, cluster.address)(where, [(0.1, "")] * 6, lambda *_: None))
    assert found <= {worker.pid for worker in cluster.workers}
    assert fan_out(1, cluster.address)(where, [], lambda *_: None) == []


def test_what_a_part_raises_is_raised_here(cluster: Cluster) -> None:
    with pytest.raises(OptionError, match="there is none") as raised:
        fan_out(1, cluster.address)(where, [(0.0, ""), (0.0, "wrong")], lambda *_: None)
    assert raised.value.context == {"option": "x"}


def test_a_cancel_takes_what_is_pending_from_the_cluster(cluster: Cluster, tmp_path: Path) -> None:
    def told(fraction: float, stage: str) -> None:
        if fraction > 0:
            raise CancelledError("enough")

    with pytest.raises(CancelledError):
        fan_out(1, cluster.address)(noted, [(str(tmp_path), k, 0.3) for k in range(200)], told)
    fan_out(1, cluster.address)(where, [(0.0, "")], lambda *_: None)  # which comes after all that is pending
    assert 0 < len(list(tmp_path.iterdir())) < 100


def test_the_blind_benchmark_runs_on_the_cluster(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wanted = list(cases(0, 6))
    held = {"name": wanted[0].name, "report": None, "seconds": 0.0, "pid": 0}
    monkeypatch.setenv("KILTER_DASK", cluster.address)
    (tmp_path / "there.jsonl").write_text(json.dumps(held) + "\n")
    there = benchmark(wanted, tmp_path / "there.jsonl", one=recorded)
    assert [one["name"] for one in there] == [case.name for case in wanted]
    assert there[0] == held  # it goes on where it was
    assert {one["pid"] for one in there[1:]} <= {worker.pid for worker in cluster.workers}


def test_a_worker_of_another_release_is_refused(cluster: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    of_worker = part.release()
    monkeypatch.setattr("kilter_service.jobs.fan_out.spread.release", lambda: "Kilter 9.9")
    with pytest.raises(CoreError, match=r"has Kilter .*numpy.* computed with Kilter 9\.9") as raised:
        fan_out(1, cluster.address)(where, [(0.0, "")] * 2, lambda *_: None)
    assert raised.value.code == "cluster_differs"
    assert raised.value.context["worker"] == of_worker


def test_folds_give_the_same_numbers_when_a_worker_is_killed(cluster: Cluster, tmp_path: Path) -> None:
    twin = thesis_katana()
    limits = twin.robot.limits
    q = np.random.default_rng(3).uniform(limits[:, 0], limits[:, 1], (40, twin.robot.n_joints))
    rows, options = twin.observe(q, noise_m=1e-5, seed=3), IdentifyOptions(level=1)
    alone = identify(twin.robot, rows, Folds(4), options)
    spread = identify(twin.robot, rows, Folds(4), options, each=killing(fan_out(1, cluster.address), tmp_path))
    assert [worker.poll() for worker in cluster.workers].count(-signal.SIGKILL) == 1
    assert spread.metrics == alone.metrics
    assert alone.held_rows is not None
    assert spread.held_rows is not None
    for name, left in alone.held_rows.left.items():
        np.testing.assert_array_equal(spread.held_rows.left[name], left)


def test_a_part_that_kills_its_workers_fails_the_job(tmp_path: Path) -> None:
    few = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}
    with closing(Cluster(tmp_path, workers=1, **few)) as cluster:
        with pytest.raises(CoreError, match="their memory may be full") as raised:
            fan_out(1, cluster.address)(where, [(0.0, "killed")], lambda *_: None)
        assert cluster.workers[0].wait(30) == -signal.SIGKILL
    assert raised.value.code == "part_ended"


def test_a_scheduler_without_kilter_is_named(tmp_path: Path) -> None:
    (tmp_path / "kilter_service.py").write_text("raise ModuleNotFoundError('No module named kilter_service')")
    says = r"No module named kilter_service\. Install the same Kilter"
    with (
        closing(Cluster(tmp_path, workers=1, PYTHONPATH=str(tmp_path))) as cluster,
        pytest.raises(CoreError, match=says) as raised,
    ):
        fan_out(1, cluster.address)(where, [(0.0, "")], lambda *_: None)
    assert raised.value.code == "cluster_differs"
    assert raised.value.context == {"address": cluster.address}


def run_job(client: httpx.Client, database: Database, katana: Katana, address: str) -> dict[str, Any]:
    """Have a worker identify with folds on a cluster; returns the job."""
    asked = {
        "kind": "identify", "robot": "katana", "campaigns": [katana.campaign(client, 40)], "validation": {"folds": 4},
        "options": {"level": 1},
    }  # fmt: skip
    job = client.post("/v1/jobs", json=asked).raise_for_status().json()["id"]
    with database.transaction() as session:
        claim = store.claim(session, "here", ["identify"])
    assert claim is not None
    Runner(database, each=fan_out(1, address)).run(claim)
    done: dict[str, Any] = client.get(f"/v1/jobs/{job}").raise_for_status().json()
    return done


def test_a_job_succeeds_on_the_cluster(
    cluster: Cluster, client: httpx.Client, database: Database, katana: Katana
) -> None:
    assert run_job(client, database, katana, cluster.address)["state"] == "succeeded"


def test_a_scheduler_that_is_gone_fails_the_job_with_its_address(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(part, "AWAY_S", 1.0)
    with closing(Cluster(tmp_path, workers=1)) as cluster:

        def told(done: float, stage: str) -> None:
            if done > 0.0:
                cluster.scheduler.kill()

        with pytest.raises(ServiceError, match=r"does not answer\. Start it, or correct KILTER_DASK") as raised:
            fan_out(1, cluster.address)(where, [(0.1, "")] * 1000, told)
    assert raised.value.code == "cluster_away"
    assert raised.value.context == {"address": cluster.address}


def test_a_job_without_its_scheduler_fails_with_the_code_and_no_version(
    client: httpx.Client, database: Database, katana: Katana, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(part, "CONNECT_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
    done = run_job(client, database, katana, address)
    assert (done["state"], done["error"]["code"]) == ("failed", "cluster_away")
    assert address in done["error"]["message"]
    assert client.get("/v1/robots/katana/versions").json()["versions"] == []


def test_a_missing_package_is_named_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(part, "find_spec", lambda name: None)
    with pytest.raises(ServiceError, match="pip install distributed"):
        fan_out(1, "tcp://scheduler:8786")
