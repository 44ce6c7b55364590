"""Rows of another arm, sent over HTTP as the page sends them: the server's check takes them out of use, and says so."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_service.ground.db import Database
from tests.core.watch.drifting import some_arm
from tests.service.conftest import WorkerProcess
from tests.service.test_budgets import TRACKER
from tests.service.watched_robot import DAY, Until, Watched

TOLERANCE = {"tolerance_mm": 1.0}


def refused(watched: Watched, campaign: str) -> dict[str, Any]:
    body = {"kind": "drift", "robot": watched.name, "campaigns": [campaign]}
    job = watched.client.post("/v1/jobs", json=body).raise_for_status().json()["id"]

    def read() -> dict[str, Any]:
        return dict(watched.client.get(f"/v1/jobs/{job}").json())

    assert watched.until is not None
    watched.until(lambda: read()["state"] in ("succeeded", "failed"))
    found = read()
    assert found["state"] == "failed"
    assert found["error"]["code"] == "rows_of_another_arm"
    return found


def in_use(watched: Watched, campaign: str) -> bool:
    return watched.client.get(f"/v1/campaigns/{campaign}").raise_for_status().json()["retired_at"] is None


def test_rows_of_another_arm_are_taken_out_of_use_by_the_check_itself(
    client: httpx.Client, worker: WorkerProcess, until: Until
) -> None:
    worker.start()
    arm, other = some_arm(np.random.default_rng(3)), some_arm(np.random.default_rng(99))
    watched = Watched(client, until, arm, "watched")
    watched.calibrated()
    watched.checked(arm, 2, 1)
    foreign = watched.sent(other, 6, 3, DAY + timedelta(days=2))
    body = {"kind": "drift", "robot": "watched", "campaigns": [foreign]}
    (problem,) = client.post("/v1/jobs/check", json=body).raise_for_status().json()["problems"]
    assert problem["code"] == "rows_of_another_arm"
    assert f"kilter measure campaigns retire {foreign}" in problem["message"]  # what only looks changes nothing
    assert in_use(watched, foreign)
    message = refused(watched, foreign)["error"]["message"]
    assert f"Campaign {foreign} was retired" in message
    assert f"kilter measure campaigns restore {foreign}" in message
    assert not in_use(watched, foreign)
    judged = client.get("/v1/robots/watched/acceptance", params=TOLERANCE).raise_for_status().json()
    assert foreign not in [one["id"] for one in judged["campaigns"]]
    assert judged["campaigns"]
    log = client.get("/v1/audit").raise_for_status().json()
    assert any(foreign in str(one) and "kilterd worker" in str(one) for one in log["entries"])
    client.post(f"/v1/campaigns/{foreign}/restore").raise_for_status()
    assert "still in use, because other jobs or versions name it" in refused(watched, foreign)["error"]["message"]
    assert in_use(watched, foreign)
    to_fit = watched.sent(other, 6, 4, DAY + timedelta(days=3), "train")
    assert "still in use, because it was sent to be fitted" in refused(watched, to_fit)["error"]["message"]
    assert in_use(watched, to_fit)
    assert watched.history()["checks"] == 1


def test_nothing_is_accepted_beside_rows_of_another_arm_that_nobody_checked(
    client: httpx.Client, database: Database
) -> None:
    arm, other = some_arm(np.random.default_rng(3)), some_arm(np.random.default_rng(99))
    watched = Watched(client, None, arm, "watched")
    watched.calibrated(database)
    client.post("/v1/instruments", json=TRACKER).raise_for_status()
    own = watched.sent(arm, 8, 2, DAY + timedelta(days=1))
    asked = {**TOLERANCE, "instrument": "tracker"}

    def judged(**more: str) -> dict[str, Any]:
        return dict(client.get("/v1/robots/watched/acceptance", params={**asked, **more}).raise_for_status().json())

    assert judged()["decision"] == "accepted"
    foreign = watched.sent(other, 8, 3, DAY + timedelta(days=2))
    found = judged()
    assert found["decision"] == "not_proved"
    assert [one["id"] for one in found["campaigns"]] == [own]
    assert [(one["code"], one["campaigns"]) for one in found["lacking"]] == [("rows_of_another_arm", [foreign])]
    assert f"kilter measure campaigns retire {foreign}" in found["sentence"]
    assert judged(campaign=foreign)["decision"] == "rejected"
    assert judged(campaign=own)["decision"] == "accepted"
    crashed = watched.sent(arm.after("zero_2", 0.2), 8, 4, DAY + timedelta(days=3))
    assert crashed in [
        one["id"] for one in judged()["campaigns"]
    ]  # far off, and one cause explains it: this arm has moved
    client.post(f"/v1/campaigns/{foreign}/retire").raise_for_status()
    assert judged()["decision"] == "rejected"
    client.post(f"/v1/campaigns/{crashed}/retire").raise_for_status()
    assert judged()["decision"] == "accepted"


@pytest.mark.parametrize(
    ("poses", "temperature_c", "code"), [(2, 22.0, "too_few_poses"), (6, 60.0, "another_temperature")]
)
def test_rows_that_a_check_refuses_take_part_in_nothing_until_they_are_brought_back(
    client: httpx.Client, database: Database, poses: int, temperature_c: float, code: str
) -> None:
    arm = some_arm(np.random.default_rng(3))
    watched = Watched(client, None, arm, "watched")
    watched.calibrated(database, temperature_c=22.0)
    bad = watched.sent(arm, poses, 3, DAY + timedelta(days=1), temperature_c=temperature_c)
    body = {"kind": "drift", "robot": "watched", "campaigns": [bad]}
    (problem,) = client.post("/v1/jobs/check", json=body).raise_for_status().json()["problems"]
    assert problem["code"] == code
    assert f"kilter measure campaigns retire {bad}" in problem["message"]
    assert in_use(watched, bad)

    error = watched.failed_here(database, "drift", [bad])
    assert error["code"] == code
    assert f"kilter measure campaigns restore {bad}" in error["message"]
    assert not in_use(watched, bad)
    assert watched.history()["history"] == []
    assert client.get("/v1/robots/watched/today").raise_for_status().json()["not_evaluated"] == []
    nothing = client.get("/v1/robots/watched/acceptance", params=TOLERANCE)
    assert (nothing.status_code, nothing.json()["code"]) == (409, "nothing_held_out")
    assert bad in [
        one["id"] for one in client.get("/v1/robots/watched/campaigns?retired=true").json()["campaigns"]
    ]  # seen, and brought back
    client.post(f"/v1/campaigns/{bad}/restore").raise_for_status()
    assert in_use(watched, bad)
