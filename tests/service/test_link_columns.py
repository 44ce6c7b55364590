"""Observations of the joints themselves: link-side encoders, motor angles and torques, without any position."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import numpy as np

FINAL = ("succeeded", "failed", "cancelled")
N = 3
ARM = {
    "name": "encoders", "convention": "dh",
    "joints": [{"name": f"a{j}", "limits_deg": [-180, 180]} for j in range(1, N + 1)],
    "rows": [
        {"type": "revolute", "theta_offset_deg": 0, "d_mm": 100, "a_mm": 300, "alpha_deg": 90} for _ in range(N)
    ],
}  # fmt: skip


def columns(rows: int = 600) -> dict[str, list[float]]:
    """A motion: joint 2 yields to its torque, the encoder of joint 3 is dead."""
    t = np.arange(rows) * 0.02
    rng = np.random.default_rng(1)
    out: dict[str, list[float]] = {"t_s": t.tolist()}
    for j in range(1, N + 1):
        q = 40 * np.sin(0.9 * j**0.5 * t + j)
        torque = 500 * np.cos(1.7 * t * j**0.3)
        link = q + (-2e-5 * torque if j == 2 else 0.0) + 1e-3 * rng.standard_normal(rows)
        speed = np.gradient(q, t)
        named = {
            "q{}_deg": q, "link{}_deg": link * (j != 3), "qd{}_deg_s": speed, "tau{}_nm": torque,
            "dir{}": np.sign(speed),
        }  # fmt: skip
        out |= {name.format(j): np.asarray(values).tolist() for name, values in named.items()}
    return out


def test_joint_data_need_no_position_and_are_hunted_through(
    client: httpx.Client, worker: Any, until: Callable[..., None]
) -> None:
    client.post("/v1/robots", json=ARM).raise_for_status()
    campaign = client.post("/v1/robots/encoders/campaigns", json={"name": "motion", "numbered": True}).json()["id"]
    answer = client.post(f"/v1/campaigns/{campaign}/observations", json=columns())
    assert answer.status_code in (200, 201), answer.text
    worker.start()
    options = {"effects": ["axial_compliance", "backlash", "tracking_lag"], "resamples": 20, "permutations": 5}
    body = {"kind": "gap", "robot": "encoders", "campaigns": [campaign], "options": options}
    address = client.post("/v1/jobs", json=body).raise_for_status().headers["location"]
    until(lambda: client.get(address).json()["state"] in FINAL)
    done = client.get(address).json()
    assert done["state"] == "succeeded", done["error"]
    found = done["result"]
    assert ("axial_compliance", [2]) in [(e["id"], e["joints"]) for e in found["effects"]]
    assert "dead_encoder" in {w["code"] for w in found["warnings"]}
    assert found["gap"]["after_deg"] < found["gap"]["before_deg"]
    version = client.get(f"/v1/versions/{found['version_id']}").json()
    assert version["metrics"] == {}
    assert client.get("/v1/robots/encoders/versions").json()["versions"]


def test_a_link_encoder_is_given_for_every_joint(client: httpx.Client) -> None:
    client.post("/v1/robots", json=ARM).raise_for_status()
    campaign = client.post("/v1/robots/encoders/campaigns", json={"name": "motion", "numbered": True}).json()["id"]
    rows = columns(10)
    del rows["link2_deg"]
    answer = client.post(f"/v1/campaigns/{campaign}/observations", json=rows)
    assert (answer.status_code, answer.json()["context"]["column"]) == (400, "link2_deg"), answer.text
