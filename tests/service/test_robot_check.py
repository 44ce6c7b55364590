"""The check of a robot document before it is added."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from kilter_core.arm.presets import preset_document


def check(client: httpx.Client, document: dict[str, Any]) -> dict[str, Any]:
    answer = client.post("/v1/robots/check", json=document)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def suspicious(client: httpx.Client, **changes: Any) -> str:
    return " ".join(check(client, preset_document("ur10") | changes)["suspicious"])


def test_axes_zero_and_reach(shared_client: httpx.Client) -> None:
    found = check(shared_client, preset_document("ur10"))
    assert [axis["angle_to_previous_deg"] for axis in found["axes"]] == [None, 90, 0, 0, 90, 90]
    assert [axis["distance_to_previous_mm"] for axis in found["axes"]] == [None, 0, 612, 572.3, 0, 0]
    # UR10 at zero, by its data sheet's table: stretched along -x, the wrist to the side.
    tool = found["zero"]["tool"]
    assert (tool["x_mm"], tool["y_mm"]) == pytest.approx((-1184.3, -256.141), abs=1e-6)
    assert tool["z_mm"] == pytest.approx(127.3 - 115.7, abs=1e-6)
    assert found["zero"]["points_mm"][0] == [0, 0, 0]
    assert 1300 < found["reach_mm"] < 1400  # data sheet: 1300 to the centre of wrist 3
    assert found["suspicious"] == []
    listed = shared_client.get("/v1/robots").json()["robots"]
    assert "ur10" not in [robot["name"] for robot in listed]


def test_a_joint_read_against_the_horizontal_is_no_joint_too_many(shared_client: httpx.Client) -> None:
    chain = {"name": "ur10", "convention": "chain", "joints": [{"name": "lift"}, {"name": "elbow"}, {"name": "roll"}]}
    steps = [("Ry", "lift", 1), ("Ry", "lift", -1), ("Ry", "elbow", 1), ("Rx", "roll", 1)]
    elements = [
        part
        for axis, joint, ratio in steps
        for part in (
            {"axis": axis, "joint": joint, "ratio": ratio},
            {"axis": "Tz", "value": 0.0 if ratio < 0 else 300.0},
        )
    ]
    found = check(shared_client, {**chain, "elements": elements})
    assert not [line for line in found["suspicious"] if "same axis" in line]


def test_what_looks_wrong_is_said(shared_client: httpx.Client) -> None:
    rows = preset_document("ur10")["rows"]
    metres = [row | {"d_mm": row["d_mm"] / 1e3, "a_mm": row["a_mm"] / 1e3} for row in rows]
    assert "lengths in metres" in suspicious(shared_client, rows=metres)
    radians = [row | {"alpha_deg": row["alpha_deg"] / 57.29577951} for row in rows]
    assert "rows[0].alpha_deg is 1.5708, taken as degrees: it looks like radians" in suspicious(
        shared_client, rows=radians
    )
    joints = [{"name": f"j{k}", "limits_deg": [-3.14, 3.14]} for k in range(6)]
    assert "look like radians" in suspicious(shared_client, joints=joints)
    assert "No limits for j0, j1" in suspicious(shared_client, joints=[{"name": f"j{k}"} for k in range(6)])
    same = [row | {"a_mm": 0.0} if k == 1 else row for k, row in enumerate(rows)]
    assert "shoulder_lift and elbow rotate about the same axis" in suspicious(shared_client, rows=same)
    tilted = [row | {"alpha_deg": 0.2} if k == 1 else row for k, row in enumerate(rows)]
    assert "shoulder_lift and elbow are 0.2000 deg from parallel" in suspicious(shared_client, rows=tilted)
    assert "No link has a mass" in suspicious(shared_client, links=None)
    assert "Gravity is 1" in suspicious(shared_client, gravity_m_s2=[0, 0, -1])
    joints = [{"name": f"j{k}", "limits_deg": [10, 60]} for k in range(6)]
    assert "Zero lies outside the limits of j0" in suspicious(shared_client, joints=joints)
    links = [link | {"inertia_kg_m2": [1, 0.1, 0.1, 0, 0, 0]} for link in preset_document("ur10")["links"]]
    assert "links[0]: no body has this inertia" in suspicious(shared_client, links=links)


def test_what_cannot_be_an_arm_is_refused_as_when_it_is_added(shared_client: httpx.Client) -> None:
    answer = shared_client.post("/v1/robots/check", json={"name": "x", "convention": "preset", "preset": "nothing"})
    assert (answer.status_code, answer.json()["code"]) == (400, "robot_invalid")


def test_a_urdf_in_millimetres_is_told_what_a_urdf_counts_in(shared_client: httpx.Client) -> None:
    def arm(length: float) -> dict[str, Any]:
        links = "".join(f'<link name="l{k}"/>' for k in range(4))
        joints = "".join(
            f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
            f'<origin xyz="0 0 {length}"/><axis xyz="{k % 2} {1 - k % 2} 0"/>'
            f'<limit lower="-1.5" upper="1.5" effort="1" velocity="1"/></joint>'
            for k in range(3)
        )
        urdf = f'<robot name="arm">{links}{joints}</robot>'
        return {"name": "arm", "convention": "urdf", "urdf": urdf, "base_link": "l0", "tip_link": "l3"}

    said = " ".join(check(shared_client, arm(400.0))["suspicious"])
    assert "are its lengths in millimetres? A URDF counts in metres" in said
    said = " ".join(check(shared_client, arm(0.4e-3))["suspicious"])
    assert "Fields ending in _mm" not in said
    assert "A URDF counts in metres" in said
