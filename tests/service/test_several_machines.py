"""Two `kilterd api` and two `kilterd worker`, each a process of its own, on one PostgreSQL: as on four machines.

`python -m tools.lab machines` runs the kill too, which waits until the silence of a worker is noticed.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import func, select

from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import ActivationRow, FleetRobotRow, HeartbeatRow, JobRow, VersionRow
from kilter_service.ground.settings import Settings
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import Katana, WorkerProcess
from tests.service.forked import ForkedPopen
from tests.service.postgresql import database_of

REPOSITORY = Path(__file__).resolve().parents[2]
Until = Callable[..., None]
FINAL = ("succeeded", "failed", "cancelled")
ROBOTS = [f"arm-{k}" for k in range(6)]


class Api:
    """A `kilterd api` with a data folder of its own."""

    def __init__(self, folder: Path, url: str) -> None:
        self.settings = Settings(data=folder, database_url=url, port=0)
        environment = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
        self.process = ForkedPopen(
            [sys.executable, "-m", "kilter_service", "api"],
            env={**environment, **self.settings.environment()}, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self.process.stdout is not None
        headers = {"Authorization": f"Bearer {admin_token(self.settings)}"}
        ready = json.loads(self.process.stdout.readline())
        self.client = httpx.Client(base_url=ready["url"], headers=headers, timeout=60)

    def close(self) -> None:
        self.client.close()
        self.process.terminate()
        self.process.communicate(timeout=30)


class Site:
    """The four processes."""

    def __init__(self, url: str, folder: Path, opened: ExitStack) -> None:
        self.database = Database(url)
        opened.callback(self.database.close)
        self.apis = [Api(folder / name, url) for name in ("one", "two")]
        for api in self.apis:
            opened.callback(api.close)
        self.one, self.two = (api.client for api in self.apis)
        self.settings = Settings(data=folder / "worker", database_url=url, port=0, worker_name="same")
        self._opened = opened
        self.workers = [self.worker(), self.worker()]

    def worker(self) -> WorkerProcess:
        worker = WorkerProcess(self.settings, self.database)
        self._opened.callback(worker.kill)
        worker.start()
        return worker

    def by_pid(self, name: str) -> WorkerProcess:
        """The process of a worker."""
        with self.database.reading() as session:
            pid = session.execute(select(HeartbeatRow.pid).where(HeartbeatRow.name == name)).scalar_one()
        return next(one for one in self.workers if one.process is not None and one.process.pid == pid)


def furnish(site: Site) -> None:
    """Give the site its robots, each with a campaign."""
    for k, robot in enumerate(ROBOTS):
        site.one.post("/v1/robots", json={**Katana.document, "name": robot}).raise_for_status()
        made = site.one.post(f"/v1/robots/{robot}/campaigns", json={"name": "measured", "numbered": True})
        columns = Katana().columns(400, k)
        place = f"/v1/campaigns/{made.raise_for_status().json()['id']}/observations"
        site.one.post(place, json=columns).raise_for_status()


@pytest.fixture(scope="module")
def site(postgresql: str, postgresql_template: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with database_of(postgresql, postgresql_template) as url, ExitStack() as opened:
        yield Site(url, tmp_path_factory.mktemp("site"), opened)


def test_upload_job_events_and_cancel_go_through_any_of_them(site: Site, katana: Katana) -> None:
    campaign = katana.campaign(site.one, 200)
    asked = {"kind": "identify", "robot": "katana", "campaigns": [campaign], "validation": {"folds": 190}}
    job = site.two.post("/v1/jobs", json={**asked, "options": {"level": 3}}).raise_for_status().json()["id"]
    told: list[str] = []
    with site.one.stream("GET", f"/v1/jobs/{job}/events") as events:
        assert events.status_code == 200
        for line in events.iter_lines():
            told += [line] if line.startswith(("event", "data")) else []
            if "fold" in line and len(told) > 2 and "cancelled" not in told:
                done = site.two.post(f"/v1/jobs/{job}/cancel").raise_for_status().json()
                assert done["state"] == "cancelled"
                told.append("cancelled")
    assert told[-2] == "event: end"
    assert json.loads(told[-1].removeprefix("data: "))["state"] == "cancelled"

    quick = site.one.post("/v1/jobs", json={**asked, "validation": None, "options": {"level": 1}}).json()["id"]
    with site.two.stream("GET", f"/v1/jobs/{quick}/events") as events:
        lines = [line for line in events.iter_lines() if line.startswith("data")]
    finished = json.loads(lines[-1].removeprefix("data: "))
    assert finished["state"] == "succeeded"
    assert site.two.get(f"/v1/versions/{finished['result']['version_id']}").status_code == 200


@pytest.mark.slow
def test_a_fleet_has_one_version_for_each_robot_though_a_worker_is_killed(site: Site, until: Until) -> None:
    furnish(site)
    asked = {"robots": ROBOTS, "options": {"level": 3}, "name": "autumn"}
    fleet = site.two.post("/v1/fleet-jobs", json=asked).raise_for_status().json()["id"]

    def state() -> dict[str, Any]:
        found: dict[str, Any] = site.one.get(f"/v1/fleet-jobs/{fleet}").raise_for_status().json()
        return found

    killed, dead = _kill_one_that_computes(site, fleet, until)
    site.workers.append(site.worker())
    until(lambda: state()["state"] in FINAL)
    done = state()
    assert (done["state"], done["counts"]["succeeded"]) == ("succeeded", len(ROBOTS)), done
    assert done["progress"] == {"fraction": 1.0, "stage": f"{len(ROBOTS)} of {len(ROBOTS)} robots"}
    assert [row["robot"] for row in done["report"]] == ROBOTS
    assert all(row["held_out_after_mm"] > 0 for row in done["report"])
    with site.database.reading() as session:
        jobs = select(FleetRobotRow.job_id).where(FleetRobotRow.fleet_id == fleet)
        counted = select(VersionRow.robot_id, func.count()).where(VersionRow.job_id.in_(jobs))
        versions = session.execute(counted.group_by(VersionRow.robot_id)).all()
        assert [count for _, count in versions] == [1] * len(ROBOTS)
        again = session.get_one(JobRow, killed)
        assert again.attempts == 2
        assert again.worker != dead
        assert session.execute(select(func.count()).select_from(ActivationRow)).scalar_one() == 0
    assert site.two.get("/v1/robots/arm-0/versions").json()["versions"][0]["name"] == "autumn"


def _kill_one_that_computes(site: Site, fleet: str, until: Until) -> tuple[str, str]:
    """Kill a worker in the middle of a job of the fleet; returns the job and the worker."""
    running = select(JobRow.id, JobRow.worker).join(FleetRobotRow, FleetRobotRow.job_id == JobRow.id)
    running = running.where(FleetRobotRow.fleet_id == fleet, JobRow.state == "running")
    found: list[Any] = []

    def looked() -> list[Any]:
        with site.database.reading() as session:
            return list(session.execute(running).all())

    def frozen_while_it_computes() -> bool:
        for one in looked():
            process = site.by_pid(one.worker).process
            assert process is not None
            os.kill(process.pid, signal.SIGSTOP)  # whatever it has sent is stored now, or is not
            if one in looked():
                found.append(one)
                return True
            os.kill(process.pid, signal.SIGCONT)
        return False

    until(frozen_while_it_computes)
    site.by_pid(found[0].worker).kill()
    return str(found[0].id), str(found[0].worker)


def test_a_fleet_is_cancelled_at_another_api(site: Site, until: Until) -> None:
    furnish(site)
    fleet = site.one.post("/v1/fleet-jobs", json={"robots": ROBOTS, "options": {"level": 3}}).json()["id"]
    until(lambda: site.two.get(f"/v1/fleet-jobs/{fleet}").json()["counts"]["running"] > 0)
    done = site.two.post(f"/v1/fleet-jobs/{fleet}/cancel").raise_for_status().json()
    assert (done["state"], done["counts"]["queued"], done["counts"]["running"]) == ("cancelled", 0, 0)
    after = site.one.post("/v1/fleet-jobs", json={"robots": ROBOTS[:1], "options": {"level": 1}}).json()["id"]
    until(lambda: site.one.get(f"/v1/fleet-jobs/{after}").json()["state"] in FINAL)
    assert site.one.get(f"/v1/fleet-jobs/{after}").json()["state"] == "succeeded"
    assert site.one.get(f"/v1/fleet-jobs/{fleet}").json() == done
