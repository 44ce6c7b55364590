"""A station that moved by 5 mm is told so by the result, the version and the card of the page alike."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_core.arm.presets import preset_document
from tests.core.gap.sized_twins import LARGE, sized

QUICK = {"effects": ["base_step"], "bootstraps": 199, "resamples": 1, "permutations": 1, "next_poses": 0}
CELL = (
    r'<td class="mono">{}</td><td class="unit">(\S+)</td><td class="number">(\S+) ± (\S+)</td>'
    r'\s*<td class="number">(\S+) to (\S+)</td>'
)


def test_a_large_step_is_told_as_it_is_stored(client: httpx.Client, worker: Any, until: Callable[..., None]) -> None:
    made = sized("base_step", 1, LARGE["base_step"])
    client.post("/v1/robots", json=preset_document("ur10") | {"name": "ur10"}).raise_for_status()
    address = client.post("/v1/robots/ur10/campaigns", json={"name": "rows", "numbered": True}).raise_for_status()
    campaign = address.json()["id"]
    assert made.rows.position is not None
    assert made.rows.pose_id is not None
    assert made.rows.t is not None
    columns = {f"q{k + 1}_deg": np.degrees(q).tolist() for k, q in enumerate(made.rows.q.T)}
    columns |= {f"{a}_mm": (1e3 * x).tolist() for a, x in zip("xyz", made.rows.position.T, strict=True)}
    columns |= {"pose_id": made.rows.pose_id.tolist(), "t_s": made.rows.t.tolist()}
    client.post(f"/v1/campaigns/{campaign}/observations", json=columns).raise_for_status()
    worker.start()
    body = {"kind": "gap", "robot": "ur10", "campaigns": [campaign], "options": QUICK, "validation": 0}
    job = client.post("/v1/jobs", json=body).raise_for_status().headers["location"]
    until(lambda: client.get(job).json()["state"] in ("succeeded", "failed"))
    found = client.get(job).json()["result"]
    (effect,) = found["effects"]
    kept = {p["name"]: p for p in client.get(f"/v1/versions/{found['version_id']}").json()["parameters"]}
    card = client.get(job.removeprefix("/v1")).raise_for_status().text
    for amount, truth in zip(effect["parameters"], made.truth, strict=True):
        wire = np.degrees(truth) if amount["unit"] == "deg" else 1e3 * truth
        assert amount["value"] == kept[amount["name"]]["value"]
        assert amount["interval_low"] <= wire <= amount["interval_high"]
        cell = re.search(CELL.format(amount["name"]), card)
        assert cell is not None, amount["name"]
        unit, value, sigma, low, high = cell.groups()
        assert unit == amount["unit"]
        assert abs(float(value) - wire) < 3.5 * float(sigma)
        assert float(low) - 0.01 * abs(wire) <= wire <= float(high) + 0.01 * abs(wire)
    assert effect["moves_mm"] == pytest.approx(1e3 * np.sqrt(np.mean(made.moved**2)), rel=0.03)
