"""The checks of a robot day after day, made by a real worker: charts, marks, since when, all robots, metrics, retention."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_service.contract.jobs.job import NewDriftJob
from kilter_service.db import Database
from kilter_service.jobs import store as jobs
from kilter_service.jobs.kinds.drift import DRIFT
from kilter_service.jobs.retention import store as retention
from kilter_service.robots import store as robots
from tests.core.watch.drifting import DriftingArm, some_arm, some_poses
from tests.service.conftest import WorkerProcess

Until = Callable[..., None]
NOISE = 5e-5
DAY = datetime(2026, 9, 1, 7, 0, tzinfo=UTC)


class Watched:
    """A robot that is measured again and again over HTTP."""

    def __init__(self, client: httpx.Client, until: Until, arm: DriftingArm, name: str) -> None:
        self.client, self.until, self.arm, self.name = client, until, arm, name
        client.post("/v1/robots", json={**arm.document(), "name": name}).raise_for_status()

    def sent(self, arm: DriftingArm, poses: int, seed: int, at: datetime) -> str:
        rng = np.random.default_rng(seed)
        q = some_poses(poses, rng)
        seen = arm.measured(q, rng, NOISE).position
        assert seen is not None
        body = {"name": f"{at:%Y-%m-%d}", "numbered": True, "role": "validation", "measured_at": at.isoformat()}
        made = self.client.post(f"/v1/robots/{self.name}/campaigns", json=body).raise_for_status().json()["id"]
        columns = {f"q{k + 1}_deg": np.degrees(q[:, k]).tolist() for k in range(6)}
        columns |= {f"{axis}_mm": (seen[:, k] * 1e3).tolist() for k, axis in enumerate("xyz")}
        self.client.post(f"/v1/campaigns/{made}/observations", json=columns).raise_for_status()
        return str(made)

    def done(self, kind: str, campaigns: list[str], **options: Any) -> dict[str, Any]:
        body = {"kind": kind, "robot": self.name, "campaigns": campaigns, "options": options}
        job = self.client.post("/v1/jobs", json=body).raise_for_status().json()["id"]

        def read() -> dict[str, Any]:
            return dict(self.client.get(f"/v1/jobs/{job}").json())

        self.until(lambda: read()["state"] in ("succeeded", "failed"))
        assert read()["state"] == "succeeded", read()["error"]
        return dict(read()["result"])

    def calibrated(self) -> str:
        """Fit and activate a version."""
        effects: list[Any] = [{"id": "axial_compliance", "joints": [2, 3]}]
        fit = self.sent(self.arm, 60, 1, DAY - timedelta(days=1))
        made = self.done("identify", [fit], effects=effects, noise_mm=0.05, masses="as_stated")["version_id"]
        self.client.post(f"/v1/versions/{made}/activate", json={"force": True, "reason": "test"}).raise_for_status()
        return str(made)

    def checked(self, arm: DriftingArm, seed: int, day: int) -> dict[str, Any]:
        return self.done("drift", [self.sent(arm, 6, seed, DAY + timedelta(days=day))])

    def checked_here(self, database: Database, arm: DriftingArm, seed: int, day: int) -> dict[str, Any]:
        """Check in this process as a worker does: many days take seconds."""
        campaign = self.sent(arm, 6, seed, DAY + timedelta(days=day))
        job = NewDriftJob(kind="drift", robot=self.name, campaigns=[campaign])
        with database.transaction() as session:
            robot = robots.get(session, self.name).id
            made = jobs.add(session, robot, job)
            output = DRIFT.run(jobs.load(session, made), lambda fraction, stage: None)
            jobs.succeed(session, made, output.result, None)
        return output.result

    def history(self) -> dict[str, Any]:
        return dict(self.client.get(f"/v1/robots/{self.name}/drift").raise_for_status().json())


@pytest.fixture
def arm() -> DriftingArm:
    return some_arm(np.random.default_rng(3))


def gauges(client: httpx.Client) -> dict[str, float]:
    lines = client.get("/metrics").raise_for_status().text.splitlines()
    return {line.rsplit(" ", 1)[0]: float(line.rsplit(" ", 1)[1]) for line in lines if line.startswith("kilter_drift_")}


def test_what_creeps_is_seen_by_all_checks_together(
    client: httpx.Client, worker: WorkerProcess, until: Until, arm: DriftingArm, database: Database
) -> None:
    worker.start()
    watched, other = (Watched(client, until, arm, name) for name in ("creeping", "fresh"))
    assert watched.history()["state"] == "never"
    version = watched.calibrated()
    before = [watched.checked_here(database, arm, 100 + day, day) for day in range(25)]
    assert [one["verdict"] for one in before] == 25 * ["ok"]
    found = watched.history()
    assert (found["state"], found["checks"]) == ("ok", 25)
    charts = {one["name"]: one for one in found["charts"]}
    assert {"zero_2", "sag_2", "scale", "base_x", "tool_z"} <= set(charts)
    assert charts["zero_2"]["unit"] == "deg"
    assert charts["zero_2"]["up"][:2] == [None, None]
    assert not any(one["alarms"] for one in found["charts"])
    size = np.median([one["value"] for made in before for one in made["smallest"] if one["name"] == "zero_2"])
    step = 0.5 * float(np.radians(size))
    after = [watched.checked_here(database, arm.after("zero_2", step), 200 + day, 25 + day) for day in range(15)]
    assert sum(one["verdict"] == "ok" for one in after) >= 13  # a single check hardly sees it
    assert after[-1]["verdict"] == "ok"
    found = watched.history()
    assert found["state"] == "creeping", found["sentence"]
    chart = {one["name"]: one for one in found["charts"]}["zero_2"]
    assert chart["alarms"]
    assert chart["since"] is not None
    assert DAY + timedelta(days=12) <= datetime.fromisoformat(chart["since"]) <= DAY + timedelta(days=28)
    assert found["sentence"].startswith("creeping: ")
    assert "since 2026-09-" in found["sentence"]

    crashed = watched.checked(arm.after("zero_3", 4e-3), 300, 45)
    assert crashed["verdict"] == "moved"
    assert "zero of joint 3 by 0.2" in crashed["sentence"]
    assert " since 2026-10-10" in crashed["sentence"]  # the day on which a check last agreed
    assert watched.history()["state"] == "moved"
    told = [(one["robot"], one["state"]) for one in client.get("/v1/drift").raise_for_status().json()["robots"]]
    assert told == [("creeping", "moved"), ("fresh", "never")]
    seen = gauges(client)
    assert seen['kilter_drift_verdict{robot="creeping",verdict="moved"}'] == 1.0
    assert seen['kilter_drift_verdict{robot="creeping",verdict="ok"}'] == 0.0
    assert seen['kilter_drift_p_value{robot="creeping"}'] < 1e-6
    assert seen['kilter_drift_last_check_seconds{robot="creeping"}'] == (DAY + timedelta(days=45)).timestamp()

    # A version of what moved begins a history of its own, and the marks say so.
    last = found["history"][-1]["campaign_id"]
    campaign = watched.history()["last"]["campaign_id"]
    assert campaign != last
    made = watched.done("rezero", [campaign])["version_id"]
    client.post(f"/v1/versions/{made}/activate", json={"force": True, "reason": "test"}).raise_for_status()
    found = watched.history()
    assert [one["what"] for one in found["marks"]] == ["activated", "re-zeroed"]
    assert (found["state"], found["checks"], found["version_id"]) == ("never", 0, made)
    assert len(found["history"]) == 41
    assert [one["version_id"] for one in found["history"]] == 41 * [version]
    assert gauges(client) == {}
    watched.checked(arm.after("zero_3", 4e-3), 301, 46)
    assert watched.history()["state"] == "ok"

    with database.reading() as session:  # however old, checks are kept: they are the history
        gone = retention.ended_before(session, datetime.now(UTC) + timedelta(days=1), 1000)
    assert not set(gone) & {one["job_id"] for one in watched.history()["history"]}
    assert other.history()["sentence"] == "It has no active version that could be checked."


def test_a_date_that_was_set_back_changes_the_order_and_nothing_else(
    client: httpx.Client, worker: WorkerProcess, until: Until, arm: DriftingArm
) -> None:
    worker.start()
    watched = Watched(client, until, arm, "clock")
    watched.calibrated()
    campaign = watched.sent(arm, 6, 1001, DAY + timedelta(days=5))
    watched.done("drift", [campaign])
    watched.checked(arm, 1002, 3)
    watched.done("drift", [campaign])  # the same rows again are one check
    anew = watched.sent(arm.after("base", 0.2), 6, 1003, DAY + timedelta(days=6))
    watched.done("drift", [anew], new_setup=["base"])
    found = watched.history()
    assert [one["at"][:10] for one in found["history"]] == ["2026-09-04", "2026-09-06"]
    assert found["last"]["campaign_id"] == campaign
