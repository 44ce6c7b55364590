"""Requests sent again, also at the same time; bodies that changed on their way; activations from another state."""

from __future__ import annotations

import base64
import hashlib
import json
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest

from kilter_client import Kilter
from kilter_client.requests.connection import Connection
from kilter_client.requests.steps import Request, Step
from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import Katana, Serve
from tests.service.made_versions import store_version

# Rows of the robot: of others each upload and each activation would look for what was mixed up.
ROWS = Katana().columns(30, seed=1)
CSV = b"\n".join(
    [",".join(ROWS).encode(), *(b",".join(b"%.6f" % v for v in row) for row in zip(*ROWS.values(), strict=True))]
)


@pytest.fixture
def robot(client: httpx.Client) -> str:
    client.post("/v1/robots", json=Katana.document).raise_for_status()
    return "katana"


def at_once(client: httpx.Client, times: int, **request: Any) -> list[httpx.Response]:
    with ThreadPoolExecutor(times) as pool:
        return [done.result() for done in [pool.submit(client.request, **request) for _ in range(times)]]


def test_parallel_repeats_of_a_campaign_have_one_answer(client: httpx.Client, robot: str) -> None:
    request = {"method": "POST", "url": f"/v1/robots/{robot}/campaigns", "json": {"name": "one"}}
    answers = at_once(client, 8, **request, headers={"Idempotency-Key": "k1"})
    assert {answer.status_code for answer in answers} == {201}
    assert len({answer.text for answer in answers}) == 1
    assert {answer.headers["location"] for answer in answers} == {f"/v1/campaigns/{answers[0].json()['id']}"}
    assert len(client.get(f"/v1/robots/{robot}/campaigns").json()["campaigns"]) == 1
    # Without a key the name is taken; with another body the key is.
    assert client.request(**request).json()["code"] == "name_taken"
    other = client.request(**request | {"json": {"name": "two"}}, headers={"Idempotency-Key": "k1"})
    assert (other.status_code, other.json()["code"]) == (422, "idempotency_mismatch")
    assert "a new key" in other.json()["detail"]
    bad = client.request(**request, headers={"Idempotency-Key": "two words"})
    assert (bad.status_code, bad.json()["code"]) == (422, "payload_invalid")


def test_repeats_of_an_upload_have_the_first_answer(client: httpx.Client, robot: str) -> None:
    campaign = client.post(f"/v1/robots/{robot}/campaigns", json={"name": "one"}).json()["id"]
    url, headers = f"/v1/campaigns/{campaign}/observations", {"Content-Type": "text/csv", "Idempotency-Key": "k"}
    answers = at_once(client, 6, method="POST", url=url, content=CSV, headers=headers)
    assert {(answer.status_code, answer.text) for answer in answers} == {(201, answers[0].text)}
    assert answers[0].json()["new"] is True
    assert client.get(f"/v1/campaigns/{campaign}").json()["rows"] == 30
    other = client.post(url, content=CSV + b"\n1,2,3,4,5,6,7,8", headers=headers)
    assert (other.status_code, other.json()["code"]) == (422, "idempotency_mismatch")
    assert client.get(f"/v1/campaigns/{campaign}").json()["rows"] == 30


def test_repeats_of_a_job_are_one_job_and_another_token_has_other_keys(
    client: httpx.Client, robot: str, katana: Katana
) -> None:
    campaign = katana.campaign(client, 40)
    body = {"kind": "identify", "robot": robot, "campaigns": [campaign], "name": "fit"}
    answers = at_once(client, 6, method="POST", url="/v1/jobs", json=body, headers={"Idempotency-Key": "k"})
    assert {(answer.status_code, answer.text) for answer in answers} == {(202, answers[0].text)}
    client.post(f"/v1/jobs/{answers[0].json()['id']}/cancel").raise_for_status()
    again = client.post("/v1/jobs", json=body, headers={"Idempotency-Key": "k"})
    assert again.text == answers[0].text
    assert len(client.get("/v1/jobs").json()["jobs"]) == 1
    reordered = json.dumps(dict(reversed(body.items())), indent=3)
    same = client.post(
        "/v1/jobs", content=reordered, headers={"Idempotency-Key": "k", "Content-Type": "application/json"}
    )
    assert same.text == answers[0].text


@pytest.mark.parametrize(
    ("header", "shape"), [("Content-Digest", "sha-256=:{}:"), ("Repr-Digest", "sha-256=:{}:"), ("Digest", "SHA-256={}")]
)
def test_a_digest_of_an_upload_is_checked(client: httpx.Client, robot: str, header: str, shape: str) -> None:
    campaign = client.post(f"/v1/robots/{robot}/campaigns", json={"name": "one"}).json()["id"]
    url = f"/v1/campaigns/{campaign}/observations"

    def send(stated: str) -> httpx.Response:
        return client.post(url, content=CSV, headers={"Content-Type": "text/csv", header: stated})

    right = base64.b64encode(hashlib.sha256(CSV).digest()).decode()
    wrong = base64.b64encode(hashlib.sha256(CSV[:-1]).digest()).decode()
    refused = send(shape.format(wrong))
    assert (refused.status_code, refused.json()["code"]) == (400, "digest_mismatch")
    assert hashlib.sha256(CSV).hexdigest() in refused.json()["detail"]
    assert send("md5=:unknown:, " + shape.format(wrong)).json()["code"] == "digest_mismatch"
    assert send("nonsense").json()["code"] == "payload_invalid"
    assert client.get(f"/v1/campaigns/{campaign}").json()["uploads"] == []
    assert send("unixsum=:MTI=:, " + shape.format(right)).status_code == 201


def test_a_roll_back_sent_twice_goes_back_once(client: httpx.Client, database: Database, robot: str) -> None:
    versions = [store_version(database, robot, number) for number in range(3)]
    for version in versions:
        client.post(f"/v1/versions/{version}/activate", json={"force": True, "reason": "test"}).raise_for_status()
    state = client.get("/v1/robots/katana/activations").headers["etag"]
    done = client.post("/v1/robots/katana/rollback", headers={"If-Match": state})
    assert (done.status_code, done.json()["id"]) == (200, versions[1])
    assert done.headers["etag"] == client.get("/v1/robots/katana/activations").headers["etag"] != state
    repeat = client.post("/v1/robots/katana/rollback", headers={"If-Match": state})
    assert (repeat.status_code, repeat.json()["code"]) == (412, "activation_changed")
    assert f"now version {versions[1]} is, since" in repeat.json()["detail"]
    assert len(client.get("/v1/robots/katana/activations").json()["activations"]) == 4
    # Weak tags never match, `*` matches whatever is active, one of several is enough.
    assert (
        client.post(
            "/v1/robots/katana/rollback", headers={"If-Match": "W/" + repeat.json()["context"]["etag"]}
        ).status_code
        == 412
    )
    both = f'"other", {repeat.json()["context"]["etag"]}'
    assert client.post("/v1/robots/katana/rollback", headers={"If-Match": both}).json()["id"] == versions[0]


def test_parallel_activations_from_one_state_are_one(client: httpx.Client, database: Database, robot: str) -> None:
    first, *others = [store_version(database, robot, number) for number in range(4)]
    nothing = client.get("/v1/robots/katana/activations").headers["etag"]
    force = {"force": True, "reason": "test"}
    client.post(f"/v1/versions/{first}/activate", json=force, headers={"If-Match": nothing}).raise_for_status()
    state = client.get("/v1/robots/katana/activations").headers["etag"]
    with ThreadPoolExecutor(3) as pool:
        sent = [
            pool.submit(client.post, f"/v1/versions/{version}/activate", json=force, headers={"If-Match": state})
            for version in others
        ]
        answers = [one.result() for one in sent]
    assert sorted(answer.status_code for answer in answers) == [200, 412, 412]
    won = others[[answer.status_code for answer in answers].index(200)]
    # What is active already is done: an answer that was lost can be asked for again.
    repeat = client.post(f"/v1/versions/{won}/activate", json=force, headers={"If-Match": state})
    assert repeat.status_code == 200
    assert len(client.get("/v1/robots/katana/activations").json()["activations"]) == 2


def test_the_client_sends_keys_digests_and_states(
    settings: Settings, database: Database, serve: Serve, monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    server = serve(create_app(settings))
    seen: list[Request] = []
    done = Connection._perform_step

    def noted(self: Connection, step: Step) -> Any:
        if isinstance(step, Request):
            seen.append(step)
        return done(self, step)

    monkeypatch.setattr(Connection, "_perform_step", noted)
    (tmp_path / "rows.csv").write_bytes(CSV)
    with Kilter(str(server.base_url), token=admin_token(settings)) as kilter:
        kilter.robots.add(Katana.document)
        campaign = kilter.campaigns.add("katana", name="one")
        kilter.campaigns.upload(campaign["id"], tmp_path / "rows.csv")
        versions = [store_version(database, "katana", number) for number in range(2)]
        for version in versions:
            kilter.versions.activate(version, force=True, reason="test")
        assert kilter.versions.rollback("katana")["id"] == versions[0]
    by_path = {step.path: step.headers for step in seen if step.method == "POST"}
    assert by_path["/v1/robots/katana/campaigns"]["Idempotency-Key"]
    assert by_path["/v1/robots/katana/rollback"]["If-Match"].startswith('"activation-')
    upload = by_path[f"/v1/campaigns/{campaign['id']}/observations"]
    assert upload["Idempotency-Key"]
    assert upload["Content-Digest"].startswith("sha-256=:")
