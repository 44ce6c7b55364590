"""Many robots identified anew by one request, on SQLite with its one worker."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import pytest
from sqlalchemy import func, select

from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import JobRow, VersionRow
from kilter_service.jobs.work import store
from kilter_service.jobs.work.runner import Runner
from tests.service.conftest import Katana

Until = Callable[..., None]
LEVEL_1 = {"level": 1}


def add_robot(client: httpx.Client, name: str) -> None:
    document = {**Katana.document, "name": name}
    client.post("/v1/robots", json=document).raise_for_status()


def add_campaign(client: httpx.Client, robot: str, rows: int, seed: int, **more: Any) -> str:
    new = {"name": f"seed {seed}", **more}
    campaign = str(client.post(f"/v1/robots/{robot}/campaigns", json=new).raise_for_status().json()["id"])
    columns = Katana().columns(rows, seed)
    client.post(f"/v1/campaigns/{campaign}/observations", json=columns).raise_for_status()
    return campaign


def submit(client: httpx.Client, **asked: Any) -> dict[str, Any]:
    answer = client.post("/v1/fleet-jobs", json=asked)
    assert answer.status_code == 202, answer.text
    found: dict[str, Any] = answer.json()
    assert answer.headers["location"] == f"/v1/fleet-jobs/{found['id']}"
    return found


def get(client: httpx.Client, fleet: str) -> dict[str, Any]:
    found: dict[str, Any] = client.get(f"/v1/fleet-jobs/{fleet}").raise_for_status().json()
    return found


def work(database: Database, most: int = 100) -> int:
    """Run queued jobs as a worker does, at most so many; returns how many there were."""
    runner = Runner(database)
    for done in range(most):
        with database.transaction() as session:
            claim = store.claim(session, "here", ["identify"])
        if claim is None:
            return done
        runner.run(claim)
    return most


def rows_of(fleet: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {one["robot"]: one for one in fleet["report"]}


def test_each_robot_gets_a_version_or_a_reason(client: httpx.Client, database: Database) -> None:
    for robot in ("anna", "berta", "clara", "dora"):
        add_robot(client, robot)
    used = {robot: add_campaign(client, robot, 60, k) for k, robot in enumerate(("anna", "berta"))}
    client.post("/v1/robots/dora/retire").raise_for_status()
    queued = submit(client, options=LEVEL_1, name="autumn")
    assert (queued["state"], queued["robots"], queued["progress"]["stage"]) == ("queued", 3, "1 of 3 robots")
    assert queued["counts"]["refused"] == 1

    assert work(database, most=1) == 1
    half = get(client, queued["id"])
    assert (half["state"], half["progress"]["stage"]) == ("running", "2 of 3 robots")
    assert half["progress"]["fraction"] == pytest.approx(2 / 3)
    assert half["finished_at"] is None
    assert work(database) == 1

    done = get(client, queued["id"])
    report = rows_of(done)
    assert (done["state"], done["progress"]["fraction"]) == ("succeeded", 1.0)
    assert done["counts"] == {
        "queued": 0, "running": 0, "succeeded": 2, "failed": 0, "cancelled": 0, "refused": 1
    }  # fmt: skip
    assert done["finished_at"] is not None
    for robot, campaign in used.items():
        row = report[robot]
        assert (row["state"], row["campaigns"], row["validation"]) == ("succeeded", [campaign], 0.2)
        (version,) = client.get(f"/v1/robots/{robot}/versions").json()["versions"]
        assert (version["id"], version["name"], version["active"]) == (row["version_id"], "autumn", False)
        assert row["version_before"] is row["held_out_before_mm"] is None
        assert 0 < row["held_out_after_mm"] < row["compared"]["registration_only"]["mean_mm"]
    refused = report["clara"]
    assert (refused["state"], refused["job_id"], refused["error"]["code"]) == ("refused", None, "campaigns_invalid")
    assert "kilter upload clara FILE" in refused["error"]["message"]
    listed = client.get("/v1/fleet-jobs").json()["fleet_jobs"]
    assert listed == [{key: value for key, value in done.items() if key != "report"}]


def test_the_remedy_of_a_refusal_works(client: httpx.Client, database: Database) -> None:
    add_robot(client, "anna")
    first = get(client, submit(client, options=LEVEL_1)["id"])
    assert (first["state"], first["counts"]["refused"]) == ("failed", 1)  # over at once
    assert first["finished_at"] is not None
    add_campaign(client, "anna", 60, 1)
    second = submit(client, options=LEVEL_1)
    work(database)
    assert get(client, second["id"])["state"] == "succeeded"


def test_the_latest_campaigns_are_those_of_the_active_version_and_what_came_after(
    client: httpx.Client, database: Database
) -> None:
    add_robot(client, "anna")
    unused = add_campaign(client, "anna", 20, 1)
    first = add_campaign(client, "anna", 60, 2)
    made = submit(client, robots=["anna"], campaigns={"anna": [first]}, options={"level": 1, "seed": 3})
    work(database)
    before = rows_of(get(client, made["id"]))["anna"]["version_id"]
    client.post(f"/v1/versions/{before}/activate").raise_for_status()
    later = add_campaign(client, "anna", 80, 4)
    add_campaign(client, "anna", 20, 5, role="confirmation")

    again = submit(client, robots=["anna"])
    assert work(database) == 1
    row = rows_of(get(client, again["id"]))["anna"]
    assert row["campaigns"] == [first, later]
    assert unused not in row["campaigns"]
    job = client.get(f"/v1/jobs/{row['job_id']}").json()
    assert job["options"] == {"level": 1, "seed": 3}  # as the version before was made
    assert row["version_before"] == before
    assert row["held_out_before_mm"] > 0
    assert row["held_out_after_mm"] > 0
    # What the report says is what the activation finds when it compares the stored version.
    assert client.get("/v1/robots/anna").json()["active_version"] == before
    activated = client.post(f"/v1/versions/{row['version_id']}/activate").raise_for_status().json()
    assert activated["compared"] == row["compared"]
    assert [one for one in activated["warnings"] if one["code"] != "compensation_unknown"] == row["warnings"]

    held = add_campaign(client, "anna", 40, 6, role="validation")
    third = submit(client, robots=["anna"])
    report = rows_of(get(client, third["id"]))["anna"]
    assert (report["campaigns"], report["validation"]) == ([first, later], [held])


def test_a_robot_whose_job_fails_says_why_and_the_others_go_on(client: httpx.Client, database: Database) -> None:
    for k, robot in enumerate(("anna", "berta")):
        add_robot(client, robot)
        add_campaign(client, robot, 60 if robot == "anna" else 2, k)
    fleet = submit(client, options=LEVEL_1)
    work(database)
    done = get(client, fleet["id"])
    assert done["state"] == "succeeded"
    failed = rows_of(done)["berta"]
    assert (failed["state"], failed["version_id"]) == ("failed", None)
    assert failed["error"]["message"]


def test_cancel_ends_what_is_not_over(client: httpx.Client, database: Database) -> None:
    for k, robot in enumerate(("anna", "berta", "clara")):
        add_robot(client, robot)
        add_campaign(client, robot, 60, k)
    fleet = submit(client, options=LEVEL_1)["id"]
    work(database, most=1)
    with database.transaction() as session:
        claim = store.claim(session, "there", ["identify"])
    assert claim is not None
    done = client.post(f"/v1/fleet-jobs/{fleet}/cancel").raise_for_status().json()
    assert (done["state"], done["counts"]["cancelled"], done["counts"]["succeeded"]) == ("cancelled", 2, 1)
    Runner(database).run(claim)  # the worker notices
    assert work(database) == 0
    assert client.post(f"/v1/fleet-jobs/{fleet}/cancel").json() == done
    assert get(client, fleet) == done
    with database.reading() as session:
        assert session.execute(select(func.count()).select_from(VersionRow)).scalar_one() == 1


def test_nothing_is_left_to_cancel_of_one_that_is_over(client: httpx.Client, database: Database) -> None:
    add_robot(client, "anna")
    add_campaign(client, "anna", 60, 1)
    fleet = submit(client, options=LEVEL_1)["id"]
    work(database)
    answer = client.post(f"/v1/fleet-jobs/{fleet}/cancel")
    assert (answer.status_code, answer.json()["code"]) == (409, "job_finished")


@pytest.mark.parametrize(
    ("asked", "status", "code", "words"),
    [
        ({"robots": ["nobody"]}, 404, "robot_not_found", "nobody"),
        ({"robots": []}, 404, "robot_not_found", "at least one"),
        ({"robots": ["anna"], "campaigns": {"berta": []}}, 400, "campaigns_invalid", "'berta'"),
        ({"options": {"start": "ver_1"}}, 422, "payload_invalid", "leave it out"),
        ({"options": {"levle": 1}}, 422, "payload_invalid", "levle"),
        ({"options": {"level": 2, "effects": ["backlash_load"]}}, 400, "option_invalid", "level"),
        ({"validation": 0}, 422, "payload_invalid", "validation"),
    ],
)
def test_what_no_robot_can_have_is_refused_at_once(
    shared_client: httpx.Client, asked: dict[str, Any], status: int, code: str, words: str
) -> None:
    add_robot(shared_client, "anna")
    answer = shared_client.post("/v1/fleet-jobs", json=asked)
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    assert words in answer.text


def test_campaigns_of_another_robot_are_a_refusal_of_that_robot(client: httpx.Client) -> None:
    for robot in ("anna", "berta"):
        add_robot(client, robot)
    foreign = add_campaign(client, "berta", 60, 1)
    found = rows_of(get(client, submit(client, campaigns={"anna": [foreign]}, options=LEVEL_1)["id"]))
    assert found["anna"]["state"] == "refused"
    assert "is not of robot 'anna'" in found["anna"]["error"]["message"]
    assert found["berta"]["state"] == "queued"


def test_the_same_request_sent_again_makes_no_second_fleet(client: httpx.Client, database: Database) -> None:
    add_robot(client, "anna")
    add_campaign(client, "anna", 60, 1)
    answers = [
        client.post("/v1/fleet-jobs", json={"options": LEVEL_1}, headers={"Idempotency-Key": "once"}).json()
        for _ in range(2)
    ]
    assert answers[0] == answers[1]
    with database.reading() as session:
        assert session.execute(select(func.count()).select_from(JobRow)).scalar_one() == 1


def test_a_token_sees_fleets_of_its_own_robots_only(client: httpx.Client) -> None:
    for k, robot in enumerate(("anna", "berta")):
        add_robot(client, robot)
        add_campaign(client, robot, 60, k)
    everybody = submit(client, options=LEVEL_1)["id"]
    new = {"name": "limited", "role": "operator", "robots": ["anna"]}
    secret = client.post("/v1/tokens", json=new).raise_for_status().json()["token"]
    limited = httpx.Client(base_url=client.base_url, headers={"Authorization": f"Bearer {secret}"}, timeout=30)
    with limited:
        own = submit(limited, options=LEVEL_1)  # "all" are those that it may see
        assert own["robots"] == 1
        assert [one["id"] for one in limited.get("/v1/fleet-jobs").json()["fleet_jobs"]] == [own["id"]]
        for method, path in (("GET", ""), ("POST", "/cancel")):
            answer = limited.request(method, f"/v1/fleet-jobs/{everybody}{path}")
            assert (answer.status_code, answer.json()["code"]) == (404, "job_not_found")
        assert limited.post("/v1/fleet-jobs", json={"robots": ["berta"]}).status_code == 404
        assert limited.post(f"/v1/fleet-jobs/{own['id']}/cancel").json()["state"] == "cancelled"
    assert get(client, everybody)["state"] == "queued"


def test_a_deleted_robot_leaves_the_report(client: httpx.Client, database: Database) -> None:
    for robot in ("anna", "berta"):
        add_robot(client, robot)
    fleet = submit(client, options=LEVEL_1)["id"]
    client.delete("/v1/robots/berta").raise_for_status()
    assert list(rows_of(get(client, fleet))) == ["anna"]
