"""Levels of claim through a real server: poses held out unasked, confirmations, and what cannot be one."""

from __future__ import annotations

from typing import Any

import httpx
import numpy as np
import pytest

from tests.blind.generator import Hidden
from tests.service.test_gap import FINAL, Arm, Columns, Until

CURVE = Hidden("second_harmonic", (4,))
EFFECTS = {"effects": ["eccentricity", "second_harmonic", "encoder_scale", "axial_compliance"]}


def part(columns: Columns, poses: range) -> Columns:
    """The rows of some poses."""
    kept = [k for k, pose in enumerate(columns["pose_id"]) if int(pose) in poses]
    return {name: [values[k] for k in kept] for name, values in columns.items()}


def set_up_anew(columns: Columns) -> Columns:
    """The same rows under an instrument that stands elsewhere: turned about its vertical, and moved."""
    c, s = np.cos(0.4), np.sin(0.4)
    x, y = np.array(columns["x_mm"]), np.array(columns["y_mm"])
    z = [v + 90.0 for v in columns["z_mm"]]
    return {**columns, "x_mm": (c * x - s * y + 300.0).tolist(), "y_mm": (s * x + c * y - 150.0).tolist(), "z_mm": z}


@pytest.fixture
def arm(client: httpx.Client) -> Arm:
    return Arm(client, (CURVE,), 90)


def test_an_effect_seen_again_is_replicated_and_else_provisional(
    arm: Arm, client: httpx.Client, worker: Any, until: Until
) -> None:
    first, second = part(arm.columns, range(50)), part(arm.columns, range(50, 90))
    searched, other = arm.upload(first), arm.upload(set_up_anew(second))
    worker.start()
    alone = arm.hunt(until, searched, options=EFFECTS)
    assert [(e["id"], e["verdict"]) for e in alone["effects"]] == [("second_harmonic", "provisional")]
    assert "confirmation" in " ".join(alone["effects"][0]["to_confirm"])

    again = arm.hunt(until, searched, options=EFFECTS, confirmation=[other])
    assert [(e["id"], e["verdict"]) for e in again["effects"]] == [("second_harmonic", "replicated")]
    told = again["effects"][0]["replication"]
    assert (told["outcome"], len(told["parameters"])) == ("replicated", 2)
    version = client.get(f"/v1/versions/{again['version_id']}").json()
    assert [(c["id"], c["use"]) for c in version["campaigns"]] == [(searched, "train"), (other, "confirmation")]

    copied = arm.upload({**first, "t_s": [v + 1e4 for v in first["t_s"]]})  # the same rows in another file
    for field in ({"confirmation": [copied]}, {"options": {**EFFECTS, "confirmation": [copied]}}):
        address = arm.ask(searched, **field).raise_for_status().headers["location"]
        until(lambda address=address: client.get(address).json()["state"] in FINAL)
        done = client.get(address).json()
        assert done["confirmation"] == [copied]
        assert (done["state"], done["error"]["code"]) == ("failed", "rows_shared")
        assert "leave these rows out" in done["error"]["message"]


def test_a_quarter_is_held_out_unasked_and_counts_as_unseen(
    arm: Arm, client: httpx.Client, worker: Any, until: Until
) -> None:
    campaign = arm.upload()
    worker.start()
    held, whole = (arm.hunt(until, campaign, options=EFFECTS, **more) for more in ({}, {"validation": 0}))
    assert [e["verdict"] for e in held["effects"]] == ["class_confirmed"]
    assert [e["verdict"] for e in whole["effects"]] == ["provisional"]
    assert held["predictive"]["of"] > 0
    assert whole["predictive"] is None
    versions = [client.get(f"/v1/versions/{r['version_id']}").json() for r in (held, whole)]
    assert [v["details"].get("held_out_fraction") for v in versions] == [0.25, None]
    fewer, all_ = (v["metrics"]["train"]["n"] for v in versions)
    assert fewer < all_
    # Whether a version may be activated is judged on rows that neither it nor the active one was fitted to.
    first, second = (client.post(f"/v1/versions/{v['id']}/activate").json() for v in versions)
    assert first.get("active", True), first
    assert "nothing_to_compare" in str(second), second


@pytest.mark.parametrize(
    ("change", "status", "code", "said"),
    [
        ({"confirmation": ["cmp_none"]}, 404, "campaign_not_found", ""),
        ({"kind": "identify", "confirmation": ["self"]}, 400, "option_invalid", "only gap"),
        ({"kind": "identify", "validation": 0}, 400, "option_invalid", "Leave validation out"),
        ({"confirmation": ["self"]}, 400, "campaigns_invalid", "cannot confirm"),
        ({"confirmation": ["same file"]}, 400, "campaigns_invalid", "cannot confirm"),
        ({"confirmation": ["foreign"]}, 400, "campaigns_invalid", "name campaigns of that robot"),
        ({"options": {"bootstraps": 10**9}}, 400, "option_invalid", "from 1 to 20000"),
        ({"options": {"resamples": 10**9}}, 400, "option_invalid", "from 1 to 10000"),
        ({"options": {"matters_um": -1}}, 400, "option_invalid", "micrometres"),
    ],
)
def test_what_cannot_confirm_is_refused_at_once(
    shared_client: httpx.Client, katana: Any, change: dict[str, Any], status: int, code: str, said: str
) -> None:
    campaign, same = (katana.campaign(shared_client, 30, seed=8) for _ in range(2))
    other = shared_client.post("/v1/robots/other/campaigns", json={"name": "rows", "numbered": True})
    if other.status_code == 404:
        shared_client.post("/v1/robots", json={**katana.document, "name": "other"}).raise_for_status()
        other = shared_client.post("/v1/robots/other/campaigns", json={"name": "rows", "numbered": True})
    ids = {"self": campaign, "same file": same, "foreign": other.raise_for_status().json()["id"]}
    asked = dict(change)
    if "confirmation" in asked:
        asked["confirmation"] = [ids.get(name, name) for name in asked["confirmation"]]
    answer = shared_client.post("/v1/jobs", json={"kind": "gap", "robot": "katana", "campaigns": [campaign], **asked})
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    assert said in answer.text
