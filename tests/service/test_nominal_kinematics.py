"""Where the nominal flange is, and all joints that bring it there, over HTTP."""

from __future__ import annotations

import httpx
import pytest


@pytest.fixture(scope="module")
def robot(shared_client: httpx.Client) -> str:
    document = {"name": "nominal-irb120", "convention": "preset", "preset": "irb120"}
    assert shared_client.post("/v1/robots", json=document).status_code == 201
    return "/v1/robots/nominal-irb120"


def test_there_and_back(shared_client: httpx.Client, robot: str) -> None:
    rows = [[0, 0, 0, 0, 0, 0], [10, 20, -30, 40, 50, 60]]
    flanges = shared_client.post(f"{robot}/forward", json={"joints_deg": rows}).raise_for_status().json()["flanges"]
    # The data sheet's tool0 with all joints at zero.
    zero = {"x_mm": 374, "y_mm": 0, "z_mm": 630, "rx_deg": 0, "ry_deg": 90, "rz_deg": 0}
    assert flanges[0] == pytest.approx(zero, abs=1e-9)
    postures = shared_client.post(f"{robot}/inverse", json={"flanges": flanges}).raise_for_status().json()["postures"]
    assert any(one["singular"] for one in postures[0])
    back = [one for one in postures[1] if one["joints_deg"] == pytest.approx(rows[1], abs=1e-9)]
    assert [(one["front"], one["elbow_up"], one["singular"]) for one in back] == [(True, True, False)]
    away = {"flanges": [{"x_mm": 5000.0}]}
    assert shared_client.post(f"{robot}/inverse", json=away).json()["postures"] == [[]]


def test_other_rows_and_other_arms_are_refused(shared_client: httpx.Client, robot: str) -> None:
    short = shared_client.post(f"{robot}/forward", json={"joints_deg": [[0] * 6, [0, 0]]})
    assert (short.status_code, short.json()["code"]) == (400, "option_invalid")
    assert "Row 2 has 2 joints" in short.json()["detail"]
    shared_client.post("/v1/robots", json={"name": "nominal-panda", "convention": "preset", "preset": "panda"})
    refused = shared_client.post("/v1/robots/nominal-panda/inverse", json={"flanges": [{}]})
    assert (refused.status_code, refused.json()["code"]) == (400, "robot_invalid")
    assert "has not six revolute joints" in refused.json()["detail"]
    assert shared_client.post("/v1/robots/nobody/inverse", json={"flanges": [{}]}).status_code == 404


def test_an_arm_without_a_closed_form_has_postures_without_names(shared_client: httpx.Client) -> None:
    """Axes 4, 5 and 6 do not meet."""
    rows = [
        {"type": "revolute", "theta_offset_deg": theta, "d_mm": d, "a_mm": a, "alpha_deg": alpha}
        for theta, d, a, alpha in (
            (0, 245, 0, -90), (-90, 0, 540, 0), (0, 0, 0, -90), (0, 540, 0, 90), (0, 150, 0, -90), (0, 160, 0, 0)
        )
    ]  # fmt: skip
    arm = {"name": "nominal-offset", "convention": "dh", "rows": rows}
    assert shared_client.post("/v1/robots", json=arm).status_code == 201
    q = [10.0, 20.0, -30.0, 40.0, 50.0, 60.0]
    route = "/v1/robots/nominal-offset"
    flanges = shared_client.post(f"{route}/forward", json={"joints_deg": [q]}).raise_for_status().json()["flanges"]
    found = shared_client.post(f"{route}/inverse", json={"flanges": flanges}).raise_for_status().json()
    assert found["certain"] == [True]
    assert any(one["joints_deg"] == pytest.approx(q, abs=1e-9) for one in found["postures"][0])
    assert not any(one["named"] for one in found["postures"][0])
    refused = shared_client.post(f"{route}/inverse", json={"flanges": flanges * 201})
    assert (refused.status_code, refused.json()["code"]) == (400, "option_invalid")
    assert "for 200 poses at a time, not 201" in refused.json()["detail"]
