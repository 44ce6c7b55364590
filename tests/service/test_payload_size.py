"""Payloads in grams are asked about at upload; what an arm of the size carries is not."""

from __future__ import annotations

from typing import Any

import httpx
import numpy as np
import pytest

JSON = {"content-type": "application/json"}
LINK = {"com_mm": [0, 0, 0], "inertia_kg_m2": [0.1, 0.1, 0.1, 0, 0, 0]}


def upload(client: httpx.Client, masses_kg: float | None, reach_mm: float, payload_kg: float, by: str) -> list[Any]:
    """Warnings about an upload of a planar arm of two links, whose payload is a column or a condition."""
    name = f"a{masses_kg}-{reach_mm}-{payload_kg}-{by}".replace(".", "_")
    length = reach_mm / 2
    links = {} if masses_kg is None else {"links": [LINK | {"mass_kg": masses_kg / 2}] * 2}
    rows = [{"a_mm": length}, {"a_mm": length}]
    client.post("/v1/robots", json={"name": name, "convention": "dh", "rows": rows, **links}).raise_for_status()
    q = np.degrees(np.random.default_rng(4).uniform(-1.5, 1.5, (2, 20)))
    a, b = np.radians(q[0]), np.radians(q[0] + q[1])
    x, y = length * (np.cos(a) + np.cos(b)), length * (np.sin(a) + np.sin(b))
    table = {"q1_deg": q[0], "q2_deg": q[1], "x_mm": x, "y_mm": y, "z_mm": 0 * x}
    conditions = {"payload_kg": payload_kg} if by == "condition" else {}
    if by == "column":
        table["payload_kg"] = np.where(np.arange(20) % 2, payload_kg, 0.0)
    made = client.post(f"/v1/robots/{name}/campaigns", json={"name": "rows", "conditions": conditions})
    send = f"/v1/campaigns/{made.raise_for_status().json()['id']}/observations"
    answer = client.post(send, json={key: values.tolist() for key, values in table.items()}, headers=JSON)
    assert answer.status_code == 201, answer.text
    return [one["message"] for one in answer.json()["warnings"] if one["code"] == "payload_unlikely"]


@pytest.mark.parametrize("by", ["column", "condition"])
@pytest.mark.parametrize(("masses_kg", "reach_mm", "grams"), [(110, 1700, 500), (None, 1300, 500), (0.6, 400, 300)])
def test_grams_are_asked_about(
    shared_client: httpx.Client, masses_kg: float | None, reach_mm: float, grams: float, by: str
) -> None:
    (said,) = upload(shared_client, masses_kg, reach_mm, grams, by)
    assert f"is {grams:g} kg, but" in said
    assert f"Is it in grams? Then divide it by 1000 ({grams / 1e3:g} kg)" in said


@pytest.mark.parametrize(
    ("masses_kg", "reach_mm", "payload_kg"),
    # Public data sheets: own mass, reach, payload. Without masses, and with such as only fill a field, too.
    [
        (110, 1700, 110), (25, 717, 7), (1090, 2655, 210), (11000, 3734, 2300), (0.6, 400, 0.5), (None, 175, 1),
        (None, 460, 8), (None, 3734, 2300), (None, 280, 0.5), (0.006, 400, 0.5), (0.006, 3100, 185),
    ],
)  # fmt: skip
def test_what_arms_carry_is_not_asked_about(
    shared_client: httpx.Client, masses_kg: float | None, reach_mm: float, payload_kg: float
) -> None:
    assert upload(shared_client, masses_kg, reach_mm, payload_kg, "column") == []


def test_a_default_load_in_grams_looks_suspicious(shared_client: httpx.Client) -> None:
    arm = {"name": "loaded", "convention": "dh", "rows": [{"a_mm": 300}, {"a_mm": 200}], "load": {"payload_kg": 500}}
    report = shared_client.post("/v1/robots/check", json=arm).json()
    assert any("load.payload_kg is 500, but the arm reaches 0.5 m" in one for one in report["suspicious"])
