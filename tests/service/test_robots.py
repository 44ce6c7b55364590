from __future__ import annotations

from typing import Any

import httpx
import pytest

from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import CampaignRow

pytestmark = pytest.mark.both_databases
TWO_LINKS: dict[str, Any] = {
    "name": "arm",
    "convention": "dh",
    "rows": [{"a_mm": 300, "d_mm": 100}, {"a_mm": 200, "type": "revolute"}],
    "joints": [{"name": "j1", "limits_deg": [-170, 170]}, {"name": "j2", "limits_deg": [-120, 120], "gear_ratio": 100}],
}
URDF = """<robot name="r"><link name="base"/><link name="tip"/><link name="hand"/>
<joint name="a" type="prismatic"><parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>
<limit lower="0" upper="0.5" effort="1" velocity="1"/></joint>
<joint name="grip" type="revolute"><parent link="tip"/><child link="hand"/><axis xyz="0 0 1"/></joint></robot>"""


def test_a_robot_is_added_shown_listed_and_deleted(client: httpx.Client) -> None:
    answer = client.post("/v1/robots", json=TWO_LINKS)
    assert answer.status_code == 201
    assert answer.headers["location"] == "/v1/robots/arm"
    assert answer.json()["joints"][1] == {
        "name": "j2", "kind": "revolute", "limits_deg": [-120, 120], "limits_mm": None, "gear_ratio": 100,
        "drive_stiffness_nm_rad": None,
    }  # fmt: skip
    assert "a_1" in answer.json()["parameters"]
    assert client.get("/v1/robots/arm").json()["document"]["rows"][0]["a_mm"] == 300
    assert [robot["name"] for robot in client.get("/v1/robots").json()["robots"]] == ["arm"]
    assert client.delete("/v1/robots/arm").status_code == 204
    gone = client.get("/v1/robots/arm")
    assert (gone.status_code, gone.json()["code"]) == (404, "robot_not_found")


def test_the_same_document_twice_changes_nothing_another_is_refused(client: httpx.Client) -> None:
    client.post("/v1/robots", json=TWO_LINKS)
    assert client.post("/v1/robots", json=TWO_LINKS).status_code == 200
    other = client.post("/v1/robots", json={**TWO_LINKS, "gravity_m_s2": [0, 0, 9.8]})
    assert (other.status_code, other.json()["code"]) == (409, "robot_exists")


def test_a_robot_with_campaigns_cannot_be_deleted(client: httpx.Client, database: Database) -> None:
    client.post("/v1/robots", json=TWO_LINKS)
    with database.transaction() as session:
        row = {"id": "c", "robot_id": 1, "name": "c", "device": "", "role": "train", "conditions": {}, "notes": ""}
        session.add(CampaignRow(**row))
    refused = client.delete("/v1/robots/arm")
    assert (refused.status_code, refused.json()["code"]) == (409, "robot_in_use")


def test_presets_and_urdf_are_robots_too(client: httpx.Client) -> None:
    preset = {"name": "katana450", "convention": "preset", "preset": "katana450-chapter4"}
    assert len(client.post("/v1/robots", json=preset).json()["joints"]) == 5
    urdf = {"name": "lift", "convention": "urdf", "urdf": URDF, "base_link": "base", "tip_link": "tip",
            "joints": [{"name": "a", "limits_mm": [0, 400]}]}  # fmt: skip
    report = client.post("/v1/robots", json=urdf).json()
    assert report["joints"][0]["limits_mm"] == [0, 400]
    assert report["notes"] == ["joints outside the chain, held at zero: grip"]


@pytest.mark.parametrize(
    ("change", "status", "words"),
    [
        ({"colour": "red"}, 422, "colour"),
        ({"name": "no spaces"}, 422, "name"),
        ({"rows": [{"a_mm": "wide"}]}, 422, "a_mm"),
        ({"joints": [{"name": "j1"}]}, 400, "2 rows but 1 joints"),
        ({"joints": [{"name": "j1", "limits_deg": [5, -5]}, {"name": "j2"}]}, 400, "limits"),
        ({"convention": "preset", "preset": "r2d2", "rows": None, "joints": None}, 400, "no preset 'r2d2'"),
        ({"convention": "xacro"}, 422, "convention"),
    ],
)
def test_a_document_that_is_no_robot_is_refused(
    shared_client: httpx.Client, change: dict[str, Any], status: int, words: str
) -> None:
    document = {key: value for key, value in {**TWO_LINKS, **change}.items() if value is not None}
    answer = shared_client.post("/v1/robots", json=document)
    assert answer.status_code == status
    assert words in answer.json()["detail"]
    assert document.get("name") not in [robot["name"] for robot in shared_client.get("/v1/robots").json()["robots"]]


def test_changes_need_the_token(client: httpx.Client) -> None:
    assert client.post("/v1/robots", json=TWO_LINKS, headers={"Authorization": ""}).json()["code"] == "token_missing"
