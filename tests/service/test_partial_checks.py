"""Checks with frames set up anew say how the arm stands, too; and all surfaces count the same checks, however many."""

from __future__ import annotations

from datetime import timedelta

import httpx
import numpy as np
from pydantic import TypeAdapter

from kilter_service.contract.jobs.registry import NewJob
from kilter_service.ground.db import Database
from kilter_service.jobs import store as jobs
from kilter_service.robots import store as robots
from tests.core.watch.drifting import some_arm
from tests.service.watched_robot import DAY, Watched


def test_an_arm_whose_instrument_is_set_up_each_day_is_checked(client: httpx.Client, database: Database) -> None:
    arm = some_arm(np.random.default_rng(3))
    robot = Watched(client, None, arm, "anew")
    robot.calibrated(database)
    for day in range(2):
        assert robot.checked_here(database, arm, 100 + day, day)["verdict"] == "ok"
    elsewhere = arm.after("base", 0.05)
    rows = robot.sent(elsewhere, 6, 110, DAY + timedelta(days=2))
    assert robot.done_here(database, "drift", [rows])["verdict"] == "moved"
    assert robot.history()["state"] == "moved"
    # What the remedy says: the same rows, and that the instrument was set up anew.
    robot.done_here(database, "drift", [rows], new_setup=["base"])
    found = robot.history()
    assert (found["state"], found["last"]["campaign_id"]) == ("ok", rows)
    assert "This is with base set up anew: what looks like that is not seen (zero of joint 1)." in found["sentence"]
    assert [one["whole"] for one in found["history"]] == [True, True, False]
    assert [one["what"] for one in found["marks"]] == ["activated"]  # nothing was repaired
    assert {len(one["values"]) for one in found["charts"]} == {2}
    crashed = robot.sent(arm.after("base", 0.08).after("zero_3", 4e-3), 6, 111, DAY + timedelta(days=3))
    robot.done_here(database, "drift", [crashed], new_setup=["base"])
    assert robot.history()["state"] == "moved"
    assert client.get("/v1/drift").json()["robots"][0]["state"] == "moved"
    assert 'verdict="moved"} 1.0' in client.get("/metrics").text
    assert client.get("/robots/anew").raise_for_status().text.count("This is with base set up anew") >= 1
    text = client.get("/robots/anew").text
    assert "ok, by rows that do not show every cause" in text
    for day in range(2):  # nothing but such checks: no sum begins with the fourth
        client.post(f"/v1/campaigns/{found['history'][day]['campaign_id']}/retire").raise_for_status()
    assert "No sums: with frames set up anew" in client.get("/robots/anew").text


def test_the_list_of_all_robots_sums_as_many_checks_as_the_page_of_one(
    client: httpx.Client, database: Database
) -> None:
    """A step that half a year of checks saw is no longer one beside the last hundred alone."""
    arm = some_arm(np.random.default_rng(3))
    robot = Watched(client, None, arm, "long")
    version = robot.calibrated(database)
    (campaign,) = [robot.sent(arm, 6, 5, DAY)]
    rng, result = np.random.default_rng(1), {"verdict": "ok", "sentence": "ok: as it was.", "p_value": 0.5}
    asked = {"kind": "drift", "robot": "long", "options": {}}
    for day in range(120):
        campaign = robot.sent(arm, 3, 1000 + day, DAY + timedelta(hours=day))
        change = float(rng.normal(2.0 * (day >= 30), 1.0))
        number = {"name": "value", "unit": "deg", "change": change, "u95": 2.0, "summed": change}
        looked = [{"name": "zero_2", "words": "zero of joint 2", "numbers": [number]}]
        job = TypeAdapter(NewJob).validate_python({**asked, "campaigns": [campaign]})
        with database.transaction() as session:
            made = jobs.add(session, robots.get(session, "long").id, job)
            jobs.succeed(session, made, {**result, "version_id": version, "looked_at": looked}, None)
    found = robot.history()
    assert found["checks"] == 120
    assert found["state"] == "creeping"
    assert "most like zero of joint 2, since 2026-09-02 at the latest." in found["sentence"]
    (listed,) = client.get("/v1/drift").json()["robots"]
    assert (listed["state"], listed["sentence"], listed["checks"]) == ("creeping", found["sentence"], 120)
    assert 'kilter_drift_creeping{robot="long"} 1.0' in client.get("/metrics").text
