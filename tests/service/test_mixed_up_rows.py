"""An upload says what is mixed up before anything is stored, whole, in parts, checked beforehand, or stored long ago."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_service.campaigns import looking
from kilter_service.campaigns.facts import facts
from kilter_service.ground.db import Database
from tests.core.truth import Floats
from tests.mix_ups.campaigns import Genuine, genuine
from tests.mix_ups.columns import columns_of
from tests.service.conftest import WorkerProcess
from tests.service.watched_robot import Until

JSON = {"content-type": "application/json"}


@pytest.fixture(scope="module")
def arm() -> Genuine:
    return genuine(52, "6R", see="position")


def campaign(client: httpx.Client, arm: Genuine, **more: Any) -> str:
    client.post("/v1/robots", json=arm.pair.drawn.document() | {"name": "arm"}).raise_for_status()
    made = client.post("/v1/robots/arm/campaigns", json={"name": "rows", "numbered": True, **more}).raise_for_status()
    return str(made.json()["id"])


def turned(arm: Genuine, joint: int) -> Floats:
    """Readings of the arm with one joint the other way round."""
    return np.asarray(arm.rows.q * np.where(np.arange(arm.robot.n_joints) == joint, -1.0, 1.0))


def test_parts_that_look_good_one_by_one_are_judged_together(client: httpx.Client, arm: Genuine) -> None:
    """Eleven poses alone can be imitated by base and tool, so each part comes in; the whole does not."""
    rows = columns_of(arm, replace(arm.rows, q=turned(arm, 1)))
    staged = campaign(client, arm, staged=True)
    hashes = []
    for first in range(0, len(arm.rows), 11):
        body = json.dumps({name: values[first : first + 11] for name, values in rows.items()}).encode()
        hashes.append(hashlib.sha256(body).hexdigest())
        client.post(f"/v1/campaigns/{staged}/observations", content=body, headers=JSON).raise_for_status()
    answer = client.post(f"/v1/campaigns/{staged}/commit", json={"sha256": hashes})
    assert (answer.status_code, answer.json()["code"]) == (400, "foreign_observations")
    assert "Joint 2 looks to count the other way round" in answer.json()["detail"]
    assert client.get("/v1/robots/arm/campaigns").json()["campaigns"] == []


def test_the_same_parts_without_a_mix_up_are_committed(client: httpx.Client, arm: Genuine) -> None:
    rows = columns_of(arm)
    staged = campaign(client, arm, staged=True)
    hashes = []
    for first in range(0, len(arm.rows), 11):
        body = json.dumps({name: values[first : first + 11] for name, values in rows.items()}).encode()
        hashes.append(hashlib.sha256(body).hexdigest())
        client.post(f"/v1/campaigns/{staged}/observations", content=body, headers=JSON).raise_for_status()
    answer = client.post(f"/v1/campaigns/{staged}/commit", json={"sha256": hashes}).raise_for_status()
    assert answer.json()["rows"] == len(arm.rows)


def test_readings_outside_the_limits_are_a_mix_up_where_one_explains_them(client: httpx.Client, arm: Genuine) -> None:
    """A table of degrees whose columns say radians is outside every limit: the unit is named and not a hundred rows."""
    campaign(client, arm)
    rows = columns_of(arm)
    named = {name.replace("_deg", "_rad"): values for name, values in rows.items()}
    for address in ("/v1/robots/arm/observations/check", f"/v1/campaigns/{campaign(client, arm)}/observations"):
        problem = client.post(address, json=named).json()
        assert (problem["status"], problem["code"]) == (400, "foreign_observations")
        assert "Joints look like degrees declared as radians" in problem["detail"]
    wrong = rows | {"q2_deg": [*rows["q2_deg"][:-1], 170.0]}  # one row that no unit explains is that row
    problem = client.post("/v1/robots/arm/observations/check", json=wrong).json()
    assert (problem["code"], problem["context"]["row"]) == ("observations_invalid", len(arm.rows))


def test_what_only_looks_odd_is_stored_and_said(client: httpx.Client) -> None:
    """A target that sits a right angle off is a matter of taste: the rows come in with a warning."""
    found = genuine(57, "6R", see="pose")
    drawn = replace(found.pair.drawn, tool=found.pair.true.tool)  # the tool is known, so that a right angle is one
    arm = replace(found, pair=replace(found.pair, drawn=drawn))
    assert arm.rows.rotation is not None
    about_z = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rows = columns_of(arm, replace(arm.rows, rotation=arm.rows.rotation @ about_z))
    target = campaign(client, arm)
    for address in ("/v1/robots/arm/observations/check", f"/v1/campaigns/{target}/observations"):
        said = client.post(address, json=rows).raise_for_status().json()["warnings"]
        assert [one["code"] for one in said] == ["orientation_right_angle"]
    assert client.get(f"/v1/campaigns/{target}").json()["rows"] == len(arm.rows)
    assert client.post("/v1/robots/arm/observations/check", json=columns_of(arm)).json()["warnings"] == []


def test_a_stored_campaign_says_what_is_mixed_up_in_it(client: httpx.Client, database: Database, arm: Genuine) -> None:
    """Rows that came in pieces of few poses are there, and whoever looks at them reads why no job takes them."""
    rows, target = columns_of(arm, replace(arm.rows, q=turned(arm, 1))), campaign(client, arm)
    for first in range(0, len(arm.rows), 11):
        part = {name: values[first : first + 11] for name, values in rows.items()}
        client.post(f"/v1/campaigns/{target}/observations", json=part).raise_for_status()
    assert "Joint 2 looks to count the other way round" in facts(looking.load_campaign_rows(database, target)).mixed_up


def test_a_reading_that_was_not_taken_is_named_with_its_row(client: httpx.Client, arm: Genuine) -> None:
    """Zeros for one pose came in without a word, and the version's objection said that it was another robot."""
    rows = columns_of(arm)
    for axis in "xyz":
        rows[f"{axis}_mm"][30] = 0.0
    session = np.where(np.arange(len(arm.rows)) % 2 == 0, 2, 1)  # row 31 is the sixteenth of its session
    made = campaign(client, arm)
    answer = client.post(f"/v1/campaigns/{made}/observations", json=rows | {"session": session.tolist()})
    (said,) = [one for one in answer.raise_for_status().json()["warnings"] if one["code"] == "rows_astray"]
    assert said["rows"] == [31]
    assert said["message"].startswith("The tool is not where the joints put it in row 31 by ")
    assert "upload it again" in said["message"]


def test_a_number_that_stands_for_nothing_is_refused_with_its_row(client: httpx.Client, arm: Genuine) -> None:
    """-9999 in one pose was *not in mm, or not of this robot*."""
    rows = columns_of(arm)
    for axis in "xyz":
        rows[f"{axis}_mm"][9] = -9999.0
    answer = client.post(f"/v1/campaigns/{campaign(client, arm)}/observations", json=rows)
    assert answer.status_code == 400
    assert "The tool is not where the joints put it in row 10 by " in answer.json()["detail"]
    assert "not of this robot" not in answer.json()["detail"]


def test_rows_that_a_person_calls_right_are_stored_and_fitted_with_a_warning(
    client: httpx.Client, worker: WorkerProcess, until: Until, arm: Genuine
) -> None:
    worker.start()
    rows = columns_of(arm, replace(arm.rows, q=np.roll(arm.rows.q, 7, axis=0)))
    refused = client.post(f"/v1/campaigns/{campaign(client, arm)}/observations", json=rows)
    assert refused.json()["code"] == "foreign_observations"
    assert refused.json()["detail"].endswith("upload them to a new campaign with --unchecked.")
    right = campaign(client, arm, conditions={"unchecked": True})
    stored = client.post(f"/v1/campaigns/{right}/observations", json=rows).raise_for_status().json()
    assert [one["code"] for one in stored["warnings"]] == ["foreign_observations"]
    asked = {"kind": "identify", "robot": "arm", "campaigns": [right]}
    assert client.post("/v1/jobs/check", json=asked).raise_for_status().json()["problems"] == []
    job = client.post("/v1/jobs", json=asked).raise_for_status().json()["id"]
    until(lambda: client.get(f"/v1/jobs/{job}").json()["state"] in ("succeeded", "failed"))
    done = client.get(f"/v1/jobs/{job}").json()
    assert done["state"] == "succeeded", done["error"]
    assert "foreign_observations" in [one["code"] for one in done["result"]["warnings"]]
