"""Poses planned through a real server: within the limits, as a file, and telling what they are for."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest

Until = Callable[..., None]
FINAL = ("succeeded", "failed", "cancelled")


def planned(client: httpx.Client, until: Until, campaigns: list[str], **options: Any) -> dict[str, Any]:
    """Run a plan; its file's joints must be within the limits of the robot."""
    body = {"kind": "plan", "robot": "katana", "campaigns": campaigns, "options": options}
    address = client.post("/v1/jobs", json=body).raise_for_status().headers["location"]
    until(lambda: client.get(address).json()["state"] in FINAL)
    done = client.get(address).json()
    assert done["state"] == "succeeded", done["error"]
    result: dict[str, Any] = done["result"]
    rows = list(csv.DictReader(io.StringIO(result["csv"])))
    assert len(rows) == result["count"] == len(result["poses"])
    joints = client.get("/v1/robots/katana").json()["joints"]
    for j, joint in enumerate(joints, 1):
        low, high = joint["limits_deg"]
        assert all(low <= float(row[f"q{j}_deg"]) <= high for row in rows)
    return result


def test_poses_for_every_purpose(client: httpx.Client, katana: Any, worker: Any, until: Until) -> None:
    campaign = katana.campaign(client, 60)
    worker.start()
    assert planned(client, until, [], purpose="iso9283", count=20)["count"] == 20
    best = planned(client, until, [], purpose="identify", count=15, effects=["eccentricity"])
    assert best == planned(client, until, [], purpose="identify", count=15, effects=["eccentricity"])
    cycles = planned(client, until, [], purpose="iso9283", method="five_poses", count=3)
    assert [p["pose_id"] for p in cycles["poses"]] == 3 * [5, 4, 3, 2, 1]
    assert [p["session"] for p in cycles["poses"]] == [1] * 5 + [2] * 5 + [3] * 5
    assert cycles["csv"].splitlines()[0].endswith(",pose_id,session")
    assert (cycles["cycles"], cycles["cycles_demanded"]) == (3, 30)
    assert [p["pose_id"] for p in planned(client, until, [], purpose="iso9283", method="two_poses")["poses"]] == 30 * [
        2,
        4,
    ]
    boxed = planned(client, until, [], purpose="identify", count=8, box_mm=[[-400, -200, 100], [400, 200, 700]])
    assert boxed["count"] == 8
    assert _determines(best) > _determines(planned(client, until, [], purpose="identify", count=15, method="iso9283"))

    pair = [{"id": "axial_compliance", "joints": [3]}, {"id": "link_bending", "joints": [2]}]
    for campaigns in ([], [campaign]):
        found = planned(client, until, campaigns, purpose="separate", effects=pair, count=6, noise_mm=0.02)
        assert found["separates"] == ["axial_compliance j3", "link_bending j2"]
        assert {"repeat", "new"} == {p["kind"] for p in found["proposals"]}
        first = found["proposals"][0]
        assert first["information_factor"] > 1
        told = found["told_apart"]
        assert told["separates"] == found["separates"]
        assert told["information_factor"] == max(p["information_factor"] for p in found["proposals"])
        assert told["sentence"] in [w["message"] for w in found["warnings"]] or told["enough"]
        assert bool(told["instead"]) != told["enough"]
        assert found["poses"][0]["kind"] == first["kind"]
        assert "payload_kg" in found["csv"].splitlines()[0]


def test_poses_stay_where_the_robot_was_driven(client: httpx.Client, katana: Any, worker: Any, until: Until) -> None:
    katana.campaign(client, 60)
    worker.start()
    near = planned(client, until, [], purpose="identify", count=8, floor_mm=-50)
    far = planned(client, until, [], purpose="identify", count=40, within="limits")
    assert (near["within"], far["within"]) == ("campaigns", "limits")
    assert near["warnings"][0]["code"] == "collisions_not_checked"
    body = {"kind": "plan", "robot": "katana", "options": {"purpose": "separate"}}
    address = client.post("/v1/jobs", json=body).raise_for_status().headers["location"]
    until(lambda: client.get(address).json()["state"] in FINAL)
    assert "name two effects" in client.get(address).json()["error"]["message"]


def _determines(plan: dict[str, Any]) -> float:
    """Log determinant of the information in the poses about the geometry and eccentricities."""
    from kilter_core.arm.documents import robot_from_document
    from kilter_core.arm.presets import preset_document
    from kilter_core.effects import make_effect
    from kilter_core.identify import IdentifyOptions
    from kilter_core.model import RobotModel
    from kilter_core.observations import Observations

    robot = robot_from_document(preset_document("katana450-chapter5"))
    model = RobotModel(robot, (make_effect("eccentricity").configure_for_robot(robot),))
    q = np.radians([[pose[f"q{j}_deg"] for j in range(1, 6)] for pose in plan["poses"]])
    free = IdentifyOptions().free_parameters(model, observes_orientation=False)
    J = model.jacobian(Observations(q), model.values0(), free)[1][:, :3].reshape(-1, len(free))
    X = J * [model.parameters[k].prior_sigma for k in free] / 5e-5
    return float(np.linalg.slogdet(np.eye(len(free)) + X.T @ X)[1])


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"purpose": "paint"},
        {"purpose": "iso9283", "speed": 1},
        {"purpose": "iso9283", "count": 0},
        {"purpose": "identify", "method": "best"},
        {"purpose": "identify", "effects": ["ghost"]},
        {"purpose": "identify", "noise_mm": 0},
        {"purpose": "identify", "method": "five_poses"},
        {"purpose": "iso9283", "method": "views"},
        {"purpose": "identify", "box_mm": [[0, 0, 0], [0, 1, 1]]},
        {"purpose": "iso9283", "within": "reach"},
        {"purpose": "iso9283", "floor_mm": "low"},
        {"purpose": "identify", "payloads_kg": [-1]},
        {"purpose": "identify", "payloads_kg": 5},
        {"purpose": "separate", "effects": ["backlash", "eccentricity", "drift"]},
        {"purpose": "separate", "effects": ["backlash", {"id": "eccentricity", "joints": [0]}]},
    ],
)
def test_what_cannot_be_planned_is_refused_at_once(
    shared_client: httpx.Client, katana: Any, options: dict[str, Any]
) -> None:
    shared_client.post("/v1/robots", json=katana.document)
    answer = shared_client.post("/v1/jobs", json={"kind": "plan", "robot": "katana", "options": options})
    assert (answer.status_code, answer.json()["code"]) == (400, "option_invalid"), answer.text
