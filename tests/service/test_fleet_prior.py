"""Priors from other robots of the type over HTTP: whose versions count, what the result says, and refusals."""

from __future__ import annotations

from typing import Any

import httpx
import numpy as np
import pytest

from kilter_service.ground.caller import CALLER, Caller, as_document
from kilter_service.ground.db import Database
from kilter_service.jobs.work import store
from kilter_service.jobs.work.runner import Runner
from kilter_service.robots import store as robots
from kilter_service.versions.store import fleet_versions
from tests.core.identify.fleet.simulated import Arm, Type, document, poses
from tests.service.test_fleet_jobs import work

NOISE = 5e-5


def measured(client: httpx.Client, robot: str, arm: Arm, count: int, rng: np.random.Generator) -> str:
    """A campaign of an arm."""
    rows = arm.measured(poses(count, rng), rng, NOISE)
    assert rows.position is not None
    columns = {f"q{k + 1}_deg": np.degrees(rows.q[:, k]).tolist() for k in range(6)}
    columns |= {f"{axis}_mm": (1e3 * rows.position[:, k]).tolist() for k, axis in enumerate("xyz")}
    campaign = str(
        client.post(f"/v1/robots/{robot}/campaigns", json={"name": f"{count}"}).raise_for_status().json()["id"]
    )
    client.post(f"/v1/campaigns/{campaign}/observations", json=columns).raise_for_status()
    return campaign


def job(client: httpx.Client, robot: str, campaign: str, **options: Any) -> str:
    asked = {"kind": "identify", "robot": robot, "campaigns": [campaign], "options": options}
    answer = client.post("/v1/jobs", json=asked)
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def done(client: httpx.Client, database: Database, name: str) -> dict[str, Any]:
    work(database)
    found: dict[str, Any] = client.get(f"/v1/jobs/{name}").raise_for_status().json()
    return found


@pytest.fixture(scope="module")
def shop(shared_client: httpx.Client, shared_database: Database) -> Type:
    """Six robots of a type with a version each, one of another chain, and one that is new: each test adds campaigns."""
    rng = np.random.default_rng(30)
    kind = Type.drawn(rng)
    for k in range(6):
        shared_client.post("/v1/robots", json=document(f"r{k}")).raise_for_status()
        job(shared_client, f"r{k}", measured(shared_client, f"r{k}", kind.arm(rng), 40, rng))
    other = document("other")
    other["rows"][1]["a_mm"] += 50.0
    shared_client.post("/v1/robots", json=other).raise_for_status()
    shared_client.post("/v1/robots", json=document("new")).raise_for_status()
    assert work(shared_database) == 6
    return kind


def test_a_new_robot_is_identified_from_ten_poses(
    shared_client: httpx.Client, shared_database: Database, shop: Type
) -> None:
    kind, rng = shop, np.random.default_rng(31)
    campaign = measured(shared_client, "new", kind.arm(rng), 10, rng)
    plain = done(shared_client, shared_database, job(shared_client, "new", campaign))
    assert plain["error"]["code"] == "too_few_poses"
    found = done(shared_client, shared_database, job(shared_client, "new", campaign, prior="fleet"))
    assert found["state"] == "succeeded", found["error"]
    prior = found["result"]["prior"]
    assert [one["robot"] for one in prior["versions"]] == [f"r{k}" for k in range(6)]
    assert prior["state"] in ("used", "widened")
    assert len(prior["left_one_out"]) == 6
    marked = [one["name"] for one in found["result"]["parameters"] if one["from_prior"]]
    assert marked == prior["parameters"]
    version = shared_client.get(f"/v1/versions/{found['result']['version_id']}").raise_for_status().json()
    assert version["details"]["prior"]["source"] == "fleet"
    page = shared_client.get(f"/versions/{version['id']}", follow_redirects=True)
    assert ("from other robots of the type" in page.text) == bool(marked)
    assert prior["sentence"].split("(")[0] in page.text
    # the next robot does not learn from a version that learned from the others
    shared_client.post("/v1/robots", json=document("next")).raise_for_status()
    following = measured(shared_client, "next", kind.arm(rng), 12, rng)
    again = done(shared_client, shared_database, job(shared_client, "next", following, prior="fleet"))
    assert [one["robot"] for one in again["result"]["prior"]["versions"]] == [f"r{k}" for k in range(6)]


def test_too_few_robots_are_refused_with_the_remedy_and_in_a_check(
    shared_client: httpx.Client, shared_database: Database, shop: Type
) -> None:
    kind, rng = shop, np.random.default_rng(32)
    campaign = measured(shared_client, "other", kind.arm(rng), 12, rng)
    found = done(shared_client, shared_database, job(shared_client, "other", campaign, prior="fleet"))
    assert found["error"]["code"] == "fleet_too_few"
    assert "identify more of them without it" in found["error"]["message"]
    asked = {"kind": "identify", "robot": "other", "campaigns": [campaign], "options": {"prior": "fleet"}}
    check = shared_client.post("/v1/jobs/check", json=asked).raise_for_status().json()
    assert [one["code"] for one in check["problems"]] == ["fleet_too_few"]


def test_versions_of_another_gauge_are_named(
    shared_client: httpx.Client, shared_database: Database, shop: Type
) -> None:
    kind, rng = shop, np.random.default_rng(33)
    campaign = measured(shared_client, "new", kind.arm(rng), 12, rng)
    found = done(shared_client, shared_database, job(shared_client, "new", campaign, prior="fleet", fix=["a_4"]))
    assert found["error"]["code"] == "fleet_gauge"
    assert "of r0 is in another gauge: a_4 was fitted there alone" in found["error"]["message"]
    refused = shared_client.post(
        "/v1/jobs",
        json={
            "kind": "identify",
            "robot": "new",
            "campaigns": [campaign],
            "options": {"prior": "fleet", "method": "kalman"},
        },
    )
    assert refused.status_code == 400
    assert refused.json()["code"] == "option_invalid"


def test_whoever_may_see_some_robots_learns_from_those_alone(shared_database: Database, shop: Type) -> None:
    with shared_database.reading() as session:
        new = robots.get(session, "new").id
        assert [one.robot for one in fleet_versions(session, new, None)] == [f"r{k}" for k in range(6)]
        assert [one.robot for one in fleet_versions(session, new, ["r2", "new"])] == ["r2"]
    before = CALLER.set(Caller("somebody", "operator", frozenset({"new", "r2"}), "tok_1"))
    try:
        assert as_document()["robots"] == ["new", "r2"]
    finally:
        CALLER.reset(before)


def test_poses_are_planned_with_what_the_type_tells(
    shared_client: httpx.Client, shared_database: Database, shop: Type
) -> None:
    def planned(**options: Any) -> httpx.Response:
        given = {"purpose": "identify", "count": 8, **options}
        return shared_client.post("/v1/jobs", json={"kind": "plan", "robot": "new", "options": given})

    made = []
    for options in ({"prior": "fleet"}, {}):
        answer = planned(**options)
        assert answer.status_code == 202, answer.text
        run_one(shared_database, "plan")
        made.append(shared_client.get(f"/v1/jobs/{answer.json()['id']}").json()["result"]["poses"])
    assert len(made[0]) == len(made[1]) == 8
    assert made[0] != made[1]
    refused = planned(prior="fleet", purpose="check")
    assert refused.status_code == 400
    assert "purpose identify and method d_optimal" in refused.json()["detail"]


def run_one(database: Database, kind: str) -> None:
    with database.transaction() as session:
        claim = store.claim(session, "here", [kind])
    assert claim is not None
    Runner(database).run(claim)


def test_a_gap_search_begins_with_what_the_type_tells(
    shared_client: httpx.Client, shared_database: Database, shop: Type
) -> None:
    kind, rng = shop, np.random.default_rng(34)
    campaign = measured(shared_client, "new", kind.arm(rng), 20, rng)
    options = {"prior": "fleet", "noise_mm": 0.05, "bootstraps": 99, "resamples": 5, "permutations": 2, "next_poses": 0}
    asked = {"kind": "gap", "robot": "new", "campaigns": [campaign], "options": options}
    check = shared_client.post("/v1/jobs/check", json=asked).raise_for_status().json()
    assert check["problems"] == []
    name = shared_client.post("/v1/jobs", json=asked).raise_for_status().json()["id"]
    run_one(shared_database, "gap")
    found = shared_client.get(f"/v1/jobs/{name}").raise_for_status().json()
    assert found["state"] == "succeeded", found["error"]
    assert len(found["result"]["prior"]["versions"]) == 6
    version = shared_client.get(f"/v1/versions/{found['result']['version_id']}").raise_for_status().json()
    assert version["details"]["prior"]["source"] == "fleet"
    assert all(one["from_prior"] is not None for one in version["parameters"])
