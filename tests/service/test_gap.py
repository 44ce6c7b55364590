"""Gap hunts through a real server, on arms that were simulated without any code of Kilter's."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_service.ground.db import Database
from tests.blind.generator import Case, Hidden, Options, generate
from tests.service.stored_results import same_as_stored

Until = Callable[..., None]
Columns = dict[str, list[float]]
FINAL = ("succeeded", "failed", "cancelled")
# A part of the library and few resamples: what the service does with a report does not depend on them.
QUICK = {
    "effects": ["eccentricity", "backlash", "encoder_scale", "axial_compliance", "thermal_growth"],
    "bootstraps": 499, "resamples": 20, "permutations": 20,
}  # fmt: skip
HIDDEN = Hidden("backlash", (0,))


class Arm:
    """A simulated Katana 450 in a server."""

    def __init__(self, client: httpx.Client, hidden: tuple[Hidden, ...] = (HIDDEN,), poses: int = 45) -> None:
        case = Case("service", "katana", hidden, tuple(900.0 for _ in hidden), poses, Options(), "named", 5)
        made = generate(case)
        self.client, self.document = client, made.document
        self.columns: Columns = {name: np.asarray(values).tolist() for name, values in made.columns.items()}
        client.post("/v1/robots", json=self.document).raise_for_status()
        self.name = str(self.document["name"])

    def upload(self, columns: Columns | None = None, piece: int = 100_000) -> str:
        """Store observations as a campaign of their own, perhaps piece by piece."""
        campaign = self.client.post(
            f"/v1/robots/{self.name}/campaigns", json={"name": "rows", "numbered": True}
        ).raise_for_status()
        address = f"/v1/campaigns/{campaign.json()['id']}/observations"
        rows = columns or self.columns
        for first in range(0, len(rows["q1_deg"]), piece):
            part = {name: values[first : first + piece] for name, values in rows.items()}
            self.client.post(address, json=part).raise_for_status()
        return str(campaign.json()["id"])

    def ask(self, campaign: str, **job: Any) -> httpx.Response:
        options = {**QUICK, **job.pop("options", {})}
        body = {"kind": "gap", "robot": self.name, "campaigns": [campaign], "options": options, **job}
        return self.client.post("/v1/jobs", json=body)

    def hunt(self, until: Until, campaign: str, **job: Any) -> dict[str, Any]:
        """Run a hunt to its end; returns its result."""
        address = self.ask(campaign, **job).raise_for_status().headers["location"]
        until(lambda: self.client.get(address).json()["state"] in FINAL)
        done = self.client.get(address).json()
        assert done["state"] == "succeeded", done["error"]
        return dict(done["result"])


def without(columns: Columns, *stems: str) -> Columns:
    return {name: values for name, values in columns.items() if not name.startswith(stems)}


def test_a_hidden_effect_is_named_stored_and_gone_afterwards(
    client: httpx.Client, database: Database, worker: Any, until: Until
) -> None:
    arm = Arm(client)
    campaign = arm.upload()
    worker.start()
    found = arm.hunt(until, campaign, validation=0.25)
    assert [(e["id"], e["joints"]) for e in found["effects"]] == [("backlash", [1])]
    assert found["effects"][0]["verdict"] in ("confirmed", "class_confirmed")
    assert found["verdict"] == "closed"
    gap = found["gap"]
    assert gap["validation_after_mm"] < 0.7 * gap["validation_before_mm"]
    assert {p["factor"] for p in found["where"]}
    same_as_stored(database, client.get("/v1/jobs").json()["jobs"][0] | {"result": found})
    figures = found["figures"]
    assert {"gap_bar", "residual_joint_1", "contribution", "alias_matrix"} <= set(figures)
    assert all(set(figure) == {"data", "layout"} for figure in figures.values())

    version = client.get(f"/v1/versions/{found['version_id']}").json()
    assert (version["parent_id"], version["effects"], version["active"]) == (None, ["backlash"], False)
    metrics = version["metrics"]
    assert metrics["validation"]["identified"]["rms_mm"] < metrics["validation"]["registration_only"]["rms_mm"]
    best_rigid = metrics["validation"]["geometry_fitted"]["mean_mm"]
    assert metrics["validation"]["identified"]["mean_mm"] < 0.7 * best_rigid
    assert best_rigid < metrics["validation"]["registration_only"]["mean_mm"]
    assert metrics["validation"]["geometry_only"] == metrics["validation"]["geometry_fitted"]
    twin = client.get(f"/v1/versions/{version['id']}/export", params={"format": "mjcf"}).raise_for_status().text
    assert f"rigid, calibrated {best_rigid:.4f} mm, with the effects" in twin
    named, matrix = version["covariance"]["names"], np.array(version["covariance"]["matrix"])
    assert [row["name"] for row in version["parameters"]] == named
    assert {"base_x", "tool_z", "a_2", "backlash_1"} <= set(named)
    assert np.linalg.eigvalsh(matrix / np.sqrt(np.outer(*[np.diag(matrix)] * 2))).min() > 0
    assert version["details"]["reference"] == found["reference"] == {"base": "registration", "tool": "robot"}
    assert version["noise_mm"] == gap["noise_mm"]
    assert found["null_directions"] == version["null_directions"] != []
    amount = next(p for p in version["parameters"] if p["name"] == "backlash_1")
    assert amount["sigma"] > 0
    reported = found["effects"][0]["parameters"][0]
    assert reported["interval_low"] < amount["value"] < reported["interval_high"]

    again = arm.hunt(until, campaign, options={"start": version["id"]})
    assert (again["verdict"], again["effects"]) == ("no_gap", [])
    assert again["smallest_detectable"]
    child = client.get(f"/v1/versions/{again['version_id']}").json()
    assert (child["parent_id"], child["effects"]) == (version["id"], ["backlash"])


def test_campaigns_without_sessions_have_a_tool_each_where_that_is_asked_for(
    client: httpx.Client, worker: Any, until: Until
) -> None:
    arm = Arm(client, ())
    poses = np.array(arm.columns["pose_id"])
    halves = [
        {
            name: [value for value, k in zip(values, poses, strict=True) if k % 2 == side]
            for name, values in arm.columns.items()
        }
        for side in (0, 1)
    ]
    first, second = (arm.upload(without(half, "session")) for half in halves)
    worker.start()
    found = arm.hunt(until, first, campaigns=[first, second], validation=0, options={"refit": ["tool"]})
    version = client.get(f"/v1/versions/{found['version_id']}").json()
    assert (found["effects"], version["effects"]) == ([], ["session_shift"])
    shifts = [row for row in version["parameters"] if row["name"].startswith("session_1_")]
    assert len(shifts) == 6  # it may have rotated, too
    assert all(abs(row["value"]) < 4.5 * row["sigma"] for row in shifts)
    alone = arm.ask(first, options={"refit": ["tool"]})
    until(lambda: client.get(alone.headers["location"]).json()["state"] in FINAL)
    assert "needs two of them" in client.get(alone.headers["location"]).json()["error"]["message"]


def test_what_the_data_lack_is_said(client: httpx.Client, worker: Any, until: Until) -> None:
    arm = Arm(client)
    whole = arm.columns
    first = np.unique(whole["pose_id"], return_index=True)[1]
    once = {name: [values[k] for k in first] for name, values in whole.items()}
    campaigns = [arm.upload(without(whole, "temperature")), arm.upload(once)]
    worker.start()
    blind = arm.hunt(until, campaigns[0], options={"effects": ["thermal_growth", "eccentricity"]})
    relative = arm.hunt(until, campaigns[1])
    growth = next(row for row in blind["not_testable"] if row["id"] == "thermal_growth")
    assert "temperature_c" in growth["reason"]
    assert growth["remedy"]
    assert "thermal_growth" not in {e["id"] for e in blind["effects"]}
    # One row per pose: nothing tells the noise, so no verdict can be more than provisional.
    assert "no_repeats" in {w["code"] for w in relative["warnings"]}
    assert "relative" in relative["sentence"]
    assert {e["verdict"] for e in relative["effects"]} <= {"provisional"}


@pytest.mark.parametrize(
    ("kind", "mistake", "said"),
    [
        ("gap", "signs", "oint 1 looks to count the other way round"),
        (
            "identify",
            "instrument moved",
            r"The base, or the instrument, looks changed by (99|100)[.\d]* mm from row 9[5-8] on",
        ),
    ],
)
def test_a_mixed_up_campaign_fails_with_what_was_mixed_up(
    client: httpx.Client, worker: Any, until: Until, mistake: str, said: str, kind: str
) -> None:
    arm = Arm(client, ())
    wrong = dict(arm.columns)
    if mistake == "signs":
        wrong["q1_deg"] = [-v for v in wrong["q1_deg"]]
    else:  # for half of the campaign the tracker stood 100 mm further back
        half = len(wrong["x_mm"]) // 2
        wrong["x_mm"] = [v + (100 if k > half else 0) for k, v in enumerate(wrong["x_mm"])]
    with pytest.raises(httpx.HTTPStatusError) as refused:
        arm.upload(wrong)
    assert re.search(said, refused.value.response.json()["detail"])
    # Pieces of fewer poses than are judged come in, and the job looks at all of them.
    job = {"kind": kind, "robot": arm.name, "campaigns": [arm.upload(wrong, piece=11)]}
    address = client.post("/v1/jobs", json=job).raise_for_status().headers["location"]
    worker.start()
    until(lambda: client.get(address).json()["state"] in FINAL)
    done = client.get(address).json()
    assert (done["state"], done["error"]["code"], done["result"]) == ("failed", "foreign_observations", None)
    assert re.search(said, done["error"]["message"])
    assert "Remedy" in done["error"]["message"]
    assert client.get(f"/v1/robots/{arm.name}/versions").json()["versions"] == []


def test_too_few_poses_are_an_error_that_says_how_many(client: httpx.Client, worker: Any, until: Until) -> None:
    arm = Arm(client, (), 8)
    address = arm.ask(arm.upload()).raise_for_status().headers["location"]
    worker.start()
    until(lambda: client.get(address).json()["state"] in FINAL)
    assert client.get(address).json()["error"]["code"] == "too_few_poses"


def test_a_hunt_is_cancelled(client: httpx.Client, worker: Any, until: Until) -> None:
    arm = Arm(client)
    campaign = arm.upload()
    worker.start()
    options = {"effects": [], "resamples": 5000, "permutations": 2000}
    address = arm.ask(campaign, options=options).raise_for_status().headers["location"]
    until(lambda: client.get(address).json()["progress"]["fraction"] > 0.2)
    client.post(f"{address}/cancel").raise_for_status()
    until(lambda: client.get(address).json()["state"] == "cancelled", seconds=10)
    assert client.get(f"/v1/robots/{arm.name}/versions").json()["versions"] == []


@pytest.mark.parametrize(
    ("change", "status", "code"),
    [
        ({"options": {"start": "ver_none"}}, 404, "version_not_found"),
        ({"options": {"speed": 1}}, 400, "option_invalid"),
        ({"options": {"alpha": 0.9}}, 400, "option_invalid"),
        ({"options": {"alpha": "small"}}, 400, "option_invalid"),
        ({"options": {"effects": ["ghost"]}}, 400, "option_invalid"),
        ({"options": {"effects": "backlash"}}, 400, "option_invalid"),
        ({"options": {"base": "loose"}}, 400, "option_invalid"),
        ({"options": {"base": "removed"}}, 400, "option_invalid"),
        ({"options": {"reference": "moon"}}, 400, "option_invalid"),
        ({"options": {"limits": {"max_joint_deg": -1}}}, 400, "option_invalid"),
        ({"validation": {"folds": 5}}, 400, "option_invalid"),
        ({"campaigns": []}, 400, "campaigns_invalid"),
    ],
)
def test_what_cannot_run_is_refused_at_once(
    shared_client: httpx.Client, katana: Any, change: dict[str, Any], status: int, code: str
) -> None:
    campaign = katana.campaign(shared_client, 30)
    job = {"kind": "gap", "robot": "katana", "campaigns": [campaign], **change}
    answer = shared_client.post("/v1/jobs", json=job)
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
