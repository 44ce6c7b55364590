"""Jobs through the real job engine: the API in this process, the worker in its own."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import httpx
import pytest

from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import JobRow
from kilter_service.versions import store as versions
from tests.service.stored_results import same_as_stored

Until = Callable[..., None]
FINAL = ("succeeded", "failed", "cancelled")
# Hours of work that tell their progress at every fold.
LONG = {"validation": {"folds": 900}, "options": {"level": 3}}


def submit(client: httpx.Client, **job: Any) -> dict[str, Any]:
    answer = client.post("/v1/jobs", json={"kind": "identify", "robot": "katana", **job})
    assert answer.status_code == 202, answer.text
    found: dict[str, Any] = answer.json()
    assert answer.headers["location"] == f"/v1/jobs/{found['id']}"
    return found


def state(client: httpx.Client, job: dict[str, Any]) -> str:
    return str(client.get(f"/v1/jobs/{job['id']}").json()["state"])


def finished(client: httpx.Client, job: dict[str, Any], until: Until) -> dict[str, Any]:
    until(lambda: state(client, job) in FINAL)
    found: dict[str, Any] = client.get(f"/v1/jobs/{job['id']}").json()
    return found


@pytest.mark.both_databases
def test_identify_evaluate_and_follow(
    client: httpx.Client, database: Database, katana: Any, worker: Any, until: Until
) -> None:
    campaign, other = katana.campaign(client, 60), katana.campaign(client, 40, seed=1)
    worker.start()
    job = submit(client, campaigns=[campaign], validation=[other], options={"level": 2})
    events = []
    with client.stream("GET", f"/v1/jobs/{job['id']}/events") as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        for line in stream.iter_lines():
            if line.startswith("event: "):
                events.append([line.removeprefix("event: ")])
            elif line.startswith("data: "):
                events[-1].append(line.removeprefix("data: "))
    assert [name for name, _ in events][-1] == "end"
    assert {name for name, _ in events[:-1]} == {"progress"}
    done = json.loads(events[-1][1])
    assert done["state"] == "succeeded", done
    assert done["progress"]["fraction"] == 1
    same_as_stored(database, done)
    assert done == client.get(f"/v1/jobs/{job['id']}").json()
    metrics = done["result"]["metrics"]["validation"]
    assert metrics["n"] == 40
    assert metrics["identified"]["mean_mm"] < 0.7 * metrics["nominal"]["mean_mm"]

    version = client.get(f"/v1/versions/{done['result']['version_id']}").json()
    assert version["job_id"] == job["id"]
    assert not version["active"]
    assert [(c["id"], c["use"], c["rows"]) for c in version["campaigns"]] == [
        (campaign, "train", 60), (other, "validation", 40),
    ]  # fmt: skip
    assert version["limits"] == {
        "max_joint_deg": 2.5, "max_position_mm": 5.0, "at_limit": "saturate", "held_joints": [],
    }  # fmt: skip
    names = version["covariance"]["names"]
    assert {row["name"] for row in version["parameters"]} == set(names)
    assert len(version["covariance"]["matrix"]) == len(names)

    options = {"version": version["id"], "refit": ["base"]}
    job = submit(client, kind="evaluate", campaigns=[other], options=options)
    done = finished(client, job, until)
    same_as_stored(database, done)
    result = done["result"]
    assert result["version_id"] == version["id"]
    assert result["metrics"][other]["identified"]["mean_mm"] == pytest.approx(metrics["identified"]["mean_mm"], rel=0.2)
    assert result["metrics"][other]["within_u95"] > 0.8
    rows = result["rows"][other]
    assert [len(rows[name]) for name in ("row", "pose", "dx_mm", "u95_z_mm")] == [40] * 4
    assert min(rows["u95_x_mm"]) > 0.0
    refined = submit(client, campaigns=[campaign, other], options={"level": 2, "start": version["id"]})
    child = client.get(f"/v1/versions/{finished(client, refined, until)['result']['version_id']}").json()
    assert child["parent_id"] == version["id"]
    listed = client.get("/v1/robots/katana/versions").json()["versions"]
    assert [v["id"] for v in listed] == [child["id"], version["id"]]
    assert len(client.get("/v1/jobs", params={"robot": "katana"}).json()["jobs"]) == 3


def test_a_running_job_is_cancelled_within_seconds(
    client: httpx.Client, katana: Any, worker: Any, until: Until
) -> None:
    campaign = katana.campaign(client, 1000)
    worker.start()
    job = submit(client, campaigns=[campaign], **LONG)
    until(lambda: "fold" in client.get(f"/v1/jobs/{job['id']}").json()["progress"]["stage"])
    client.post(f"/v1/jobs/{job['id']}/cancel").raise_for_status()
    until(lambda: state(client, job) == "cancelled", seconds=10)
    again = client.post(f"/v1/jobs/{job['id']}/cancel")
    assert (again.status_code, again.json()["state"]) == (200, "cancelled")
    assert client.get("/v1/robots/katana/versions").json() == {"versions": [], "next": None}
    # The worker is free for the next one.
    few = katana.campaign(client, 3, seed=2)
    failed = finished(client, submit(client, campaigns=[few]), until)
    assert failed["state"] == "failed"
    assert failed["error"]["code"] == "too_few_poses"
    assert failed["result"] is None
    refused = client.post(f"/v1/jobs/{failed['id']}/cancel")
    assert (refused.status_code, refused.json()["code"]) == (409, "job_finished")
    assert worker.stop() == 0


def test_an_identification_does_not_wait_for_a_hunt(
    client: httpx.Client, katana: Any, worker: Any, until: Until
) -> None:
    many, few = katana.campaign(client, 10_000), katana.campaign(client, 60, seed=2)
    worker.start()
    hunt = submit(client, kind="gap", campaigns=[many])
    until(lambda: state(client, hunt) == "running", seconds=60)
    done = finished(client, submit(client, campaigns=[few], options={"level": 1}), until)
    assert done["state"] == "succeeded", done
    assert state(client, hunt) == "running"
    client.post(f"/v1/jobs/{hunt['id']}/cancel").raise_for_status()
    until(lambda: state(client, hunt) == "cancelled", seconds=30)
    assert worker.stop() == 0


def test_kill_9_resumes_and_leaves_one_version(client: httpx.Client, katana: Any, worker: Any, until: Until) -> None:
    campaign = katana.campaign(client, 200)
    worker.start()
    job = submit(client, campaigns=[campaign], validation={"folds": 8}, options={"level": 3})
    until(lambda: "fold" in client.get(f"/v1/jobs/{job['id']}").json()["progress"]["stage"])
    worker.kill()
    assert state(client, job) == "running"
    worker.start()
    done = finished(client, job, until)
    assert done["state"] == "succeeded", done
    assert done["attempts"] == 2
    assert len(client.get("/v1/robots/katana/versions").json()["versions"]) == 1


@pytest.mark.both_databases
def test_jobs_wait_for_a_worker_and_can_be_cancelled_before(
    client: httpx.Client, katana: Any, worker: Any, until: Until, database: Database
) -> None:
    """Without a worker ever started there is no job engine's database: the jobs are rows only, and are found later."""
    campaign = katana.campaign(client, 60)
    first, second = (submit(client, campaigns=[campaign], options={"level": 1}) for _ in range(2))
    cancelled = client.post(f"/v1/jobs/{second['id']}/cancel").json()
    assert cancelled["state"] == "cancelled"
    assert state(client, first) == "queued"
    worker.start()
    assert finished(client, first, until)["state"] == "succeeded"
    assert state(client, second) == "cancelled"
    with database.transaction() as session:
        assert len(versions.of_robot(session, 1)) == 1


@pytest.mark.both_databases
def test_what_cannot_run_is_refused_at_once(client: httpx.Client, katana: Any) -> None:
    campaign = katana.campaign(client, 60)
    other = {**katana.document, "name": "other"}
    client.post("/v1/robots", json=other).raise_for_status()
    same = client.post("/v1/robots/katana/campaigns", json={"name": "copy"}).json()["id"]
    client.post(f"/v1/campaigns/{same}/observations", json=katana.columns(60)).raise_for_status()
    refusals: list[tuple[dict[str, Any], int, str]] = [
        ({"kind": "paint"}, 400, "kind_unavailable"),
        ({"robot": "nobody"}, 404, "robot_not_found"),
        ({"campaigns": ["cmp_none"]}, 404, "campaign_not_found"),
        ({"validation": ["cmp_none"]}, 404, "campaign_not_found"),
        ({"robot": "other"}, 400, "campaigns_invalid"),
        ({"campaigns": []}, 400, "campaigns_invalid"),
        ({"validation": [campaign]}, 400, "campaigns_invalid"),
        ({"validation": [same]}, 400, "campaigns_invalid"),
        ({"validation": 1.5}, 422, "payload_invalid"),
        ({"validation": {"folds": 1}}, 422, "payload_invalid"),
        ({"priority": 1}, 422, "payload_invalid"),
        ({"options": {"speed": 1}}, 400, "option_invalid"),
        ({"options": {"effects": ["ghost"]}}, 400, "option_invalid"),
        ({"options": {"level": 7}}, 400, "option_invalid"),
        ({"options": {"limits": {"max_joint_deg": -1}}}, 400, "option_invalid"),
        ({"options": {"start": "ver_none"}}, 404, "version_not_found"),
        ({"kind": "evaluate", "options": {"refit": ["tool"]}}, 400, "option_invalid"),
        ({"kind": "evaluate", "options": {"speed": 1}}, 400, "option_invalid"),
    ]
    for change, status, code in refusals:
        job = {"kind": "identify", "robot": "katana", "campaigns": [campaign], **change}
        answer = client.post("/v1/jobs", json=job)
        assert (answer.status_code, answer.json()["code"]) == (status, code), (change, answer.text)
    for kind, option in (("evaluate", "refit"), ("drift", "new_setup")):
        job = {"kind": kind, "robot": "katana", "campaigns": [campaign], "options": {option: ["tool"]}}
        assert client.post("/v1/jobs", json=job).json()["detail"] == (
            f"options.{option} is ['tool']: give base, or base and tool, or leave it out, for a job of kind {kind}."
        )
    assert client.get("/v1/jobs").json() == {"jobs": [], "next": None}
    assert client.get("/v1/jobs/job_none").json()["code"] == "job_not_found"
    assert client.get("/v1/jobs/job_none/events").json()["code"] == "job_not_found"


def test_kalman_continues_from_a_version_with_two_poses(
    client: httpx.Client, katana: Any, worker: Any, until: Until
) -> None:
    campaign, few, held = (katana.campaign(client, n, seed=s) for s, n in enumerate((60, 2, 40)))
    worker.start()
    held_out = {"validation": [held]}
    first = finished(client, submit(client, campaigns=[campaign], options={"level": 2}, **held_out), until)["result"]
    more = {"level": 2, "method": "kalman", "start": first["version_id"]}
    grown = finished(client, submit(client, campaigns=[few], options=more, **held_out), until)
    assert grown["state"] == "succeeded", grown
    assert grown["result"]["method"]["continued"]
    left = [r["metrics"]["validation"]["identified"]["mean_mm"] for r in (first, grown["result"])]
    assert left[1] < 1.1 * left[0]
    sigma = [{p["name"]: p["sigma"] for p in r["parameters"]} for r in (first, grown["result"])]
    assert sigma[1]["theta_offset_2"] <= sigma[0]["theta_offset_2"]


def test_iso_9283_is_reported_or_refused(client: httpx.Client, katana: Any, worker: Any, until: Until) -> None:
    once = katana.campaign(client, 5)
    worker.start()
    options = {"metrics": "iso9283", "criteria": ["AP"]}
    refused = finished(client, submit(client, kind="evaluate", campaigns=[once], options=options), until)
    assert (refused["state"], refused["error"]["code"]) == ("failed", "metric_not_supported")
    wrong = client.post(
        "/v1/jobs", json={"kind": "evaluate", "robot": "katana", "campaigns": [once], "options": {"criteria": ["AP"]}}
    )
    assert (wrong.status_code, wrong.json()["code"]) == (400, "option_invalid")


def test_joint_parameters_from_planned_readings(
    client: httpx.Client, database: Database, katana: Any, worker: Any, until: Until
) -> None:
    katana.campaign(client, 3)
    worker.start()
    asked = {"propose": "j3", "count": 10, "payloads_kg": [0.0, 0.5]}
    plan = finished(client, submit(client, kind="joint_parameters", options=asked), until)
    assert plan["state"] == "succeeded", plan
    same_as_stored(database, plan)
    rows = plan["result"]["configurations"]
    assert len(rows) == 10
    readings = [{**row, "reading_deg": 0.01} for row in rows]  # a joint that never gives way, mounted 0.01 degrees off
    done = finished(client, submit(client, kind="joint_parameters", options={"readings": readings}), until)
    assert done["state"] == "succeeded", done
    same_as_stored(database, done)
    found = {p["name"]: p for p in done["result"]["parameters"]}
    assert set(found) == {"clearance_3", "backlash_load_3", "compliance_3"}
    assert all(abs(p["value"]) <= 3 * p["sigma"] for p in found.values())
    assert client.get(f"/v1/versions/{done['result']['version_id']}").json()["job_id"] == done["id"]
    assert "joint_without_gravity" in {w["code"] for w in done["result"]["warnings"]}
    refusals = (
        ({}, "campaigns_invalid", "or readings in"),
        ({"propose": "j3", "count": 1}, "option_invalid", "count"),
        ({"propose": "j3", "readings": readings}, "option_invalid", "either"),
    )
    for options, code, says in refusals:
        refused = client.post("/v1/jobs", json={"kind": "joint_parameters", "robot": "katana", "options": options})
        assert (refused.status_code, refused.json()["code"]) == (400, code)
        assert says in refused.json()["detail"]


def test_a_job_without_a_name_is_called_by_its_kind_its_robot_and_a_number(client: httpx.Client, katana: Any) -> None:
    campaign = katana.campaign(client, 20)
    body = {"robot": "katana", "campaigns": [campaign], "options": {"level": 1}}

    def asked(kind: str, name: str = "") -> dict[str, Any]:
        return dict(client.post("/v1/jobs", json={"kind": kind, "name": name, **body}).raise_for_status().json())

    first, own, second = asked("identify"), asked("identify", "of monday"), asked("identify")
    assert [one["name"] for one in (first, own, second)] == [
        "identification of katana 1",
        "of monday",
        "identification of katana 2",
    ]
    asked_for = {"kind": "job", "reference": "identification of katana 2"}
    assert client.get("/v1/resolve", params=asked_for).raise_for_status().json()["id"] == second["id"]


def test_a_job_of_an_earlier_release_is_called_by_its_kind_its_robot_and_its_time(
    client: httpx.Client, database: Database, katana: Any
) -> None:
    campaign = katana.campaign(client, 20)
    body = {"kind": "gap", "robot": "katana", "campaigns": [campaign]}
    job = client.post("/v1/jobs", json=body).raise_for_status().json()
    with database.transaction() as session:
        session.get_one(JobRow, job["id"]).name = ""  # as stored before jobs had names
    found = client.get(f"/v1/jobs/{job['id']}").json()
    assert found["name"] == f"gap search of katana, {found['created_at'][:19].replace('T', ' ')}"
    assert client.get("/v1/jobs").json()["jobs"][0]["name"] == found["name"]
    resolved = client.get("/v1/resolve", params={"kind": "job", "reference": found["name"]}).raise_for_status().json()
    assert (resolved["id"], resolved["name"], resolved["by"]) == (job["id"], found["name"], "name")
    other = found["name"].replace("gap search", "identification")
    assert client.get("/v1/resolve", params={"kind": "job", "reference": other}).status_code == 404
