"""A version that cannot correct is refused before it is active, with a remedy that works. Truth: Pinocchio's arm."""

from __future__ import annotations

import math
import re
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_service.ground.db import Database
from tests.core.truth import some_pose, ur10
from tests.service.test_activation_guard import Lab, codes


@pytest.fixture
def lab(client: httpx.Client, database: Database) -> Lab:
    client.post("/v1/robots", json=ur10().document()).raise_for_status()
    rng = np.random.default_rng(1)
    arm = ur10(base=some_pose(rng, 2.0), tool=some_pose(rng, 0.2))
    return Lab(client, database, arm.moved({"theta_offset_2": math.radians(2.0)}))


def objection(found: list[dict[str, Any]]) -> str:
    (message,) = [one["message"] for one in found if one["code"] == "cannot_correct"]
    return str(message)


def test_a_joint_mastered_wrong_is_refused_with_the_offset_to_enter_and_entering_it_helps(lab: Lab) -> None:
    q = lab.readings(60, 1)
    job = lab.outcome([lab.campaign(q, 1)])
    assert "cannot_correct" in codes(job["result"]["objections"])
    answer = lab.activate(job["result"]["version_id"])
    assert answer.status_code == 409
    assert lab.active() is None
    message = objection(answer.json()["context"]["objections"])
    assert re.search(r"it refuses 0, \d+ are damped and 5\d held at a limit; at most [\d.]+ mm are left", message)
    preview = answer.json()["context"]["preview"]
    assert (preview["poses"], preview["corrected"]) == (60, 60)
    assert preview["limited"] >= 50

    (offset,) = re.findall(r"([+-][\d.]+) deg as zero offset of joint 2", message)
    assert float(offset) == pytest.approx(2.0, abs=0.05)
    # The controller adds the offset: what it reads is what the joint is, and the campaign is measured again.
    points = 1e3 * lab.arm.poses(q)[0]
    entered = q + np.radians([0.0, float(offset), 0.0, 0.0, 0.0, 0.0])
    rows = {f"q{j + 1}_deg": np.degrees(entered[:, j]).tolist() for j in range(6)}
    again = lab.upload(rows | {f"{axis}_mm": points[:, k].tolist() for k, axis in enumerate("xyz")})
    lab.client.post(f"/v1/campaigns/{lab.campaigns()[0]}/retire").raise_for_status()
    done = lab.activate(lab.identify([again])).raise_for_status().json()
    assert done["objections"] == []
    assert done["preview"]["corrected"] >= 55


def test_raising_the_limits_as_it_says_helps_too(lab: Lab) -> None:
    campaign = lab.campaign(lab.readings(60, 1), 1)
    message = objection(lab.outcome([campaign])["result"]["objections"])
    ((degrees, mm),) = re.findall(r"to ([\d.]+) deg and ([\d.]+) mm \(option", message)
    raised = lab.identify([campaign], limits={"max_joint_deg": float(degrees), "max_position_mm": float(mm)})
    done = lab.activate(raised).raise_for_status().json()
    assert "cannot_correct" not in codes(done["objections"])
    assert done["preview"]["corrected"] > 0.8 * done["preview"]["poses"]


def test_it_can_be_forced_and_going_back_to_it_is_said_but_not_refused(lab: Lab) -> None:
    campaign = lab.campaign(lab.readings(60, 1), 1)
    wrong = lab.identify([campaign])
    forced = lab.activate(wrong, force=True, reason="the controller is mastered tomorrow").raise_for_status().json()
    assert "cannot_correct" in codes(forced["objections"])
    assert "cannot_correct" in codes(lab.log()[0]["objections"])
    right = lab.identify([campaign], limits={"max_joint_deg": 5, "max_position_mm": 150})
    lab.activate(right, force=True).raise_for_status()
    back = lab.client.post("/v1/robots/arm/rollback").raise_for_status().json()
    assert back["id"] == wrong
    assert "cannot_correct" in codes(back["warnings"])
    assert back["preview"]["limited"] >= 50


def test_a_good_version_says_what_it_does(client: httpx.Client, database: Database) -> None:
    client.post("/v1/robots", json=ur10().document()).raise_for_status()
    lab = Lab(client, database, ur10().moved({"a_2": 1e-3, "theta_offset_3": 1e-3}))
    done = lab.activate(lab.identify([lab.campaign(lab.readings(60, 1), 1)])).raise_for_status().json()
    assert (done["preview"]["within"], done["preview"]["poses"]) == ("campaigns", 60)
    assert done["preview"]["corrected"] >= 55
    assert 0.5 < done["preview"]["largest_mm"] < 5.0
