"""A tilt that an inclinometer reads, over HTTP: uploaded with the rows, identified, and stated in the rows to be corrected."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import numpy as np

from tests.core.effects.test_measured_tilt import Floats, campaign, document, settled

ZERO_RAD = 4e-3  # of the inclinometer in the campaign


def columns(q: Floats, x: Floats | None, y: Floats | None) -> dict[str, list[float]]:
    out = {f"q{j + 1}_deg": np.degrees(q[:, j]).tolist() for j in range(q.shape[1])}
    tilts = {"base_tilt_x_deg": x, "base_tilt_y_deg": y}
    return out | {name: np.degrees(t).tolist() for name, t in tilts.items() if t is not None}


def test_what_is_read_of_the_base_is_identified_and_corrected(
    client: httpx.Client, worker: Any, until: Callable[..., None]
) -> None:
    client.post("/v1/robots", json=document()).raise_for_status()
    rows = campaign()
    assert rows.position is not None
    table = columns(rows.q, rows.base_tilt_x, rows.base_tilt_y)
    table |= {f"{k}_mm": (1e3 * rows.position[:, i]).tolist() for i, k in enumerate("xyz")}
    made = client.post("/v1/robots/column/campaigns", json={"name": "leaning"}).raise_for_status().json()["id"]
    half = {k: v for k, v in table.items() if k != "base_tilt_y_deg"}
    refused = client.post(f"/v1/campaigns/{made}/observations", json=half)
    assert refused.status_code == 400
    assert "base_tilt_y" in refused.json()["detail"]
    client.post(f"/v1/campaigns/{made}/observations", json=table).raise_for_status()
    worker.start()
    job = {
        "kind": "identify", "robot": "column", "campaigns": [made],
        "options": {"effects": ["measured_tilt"], "noise_mm": 0.02},
    }  # fmt: skip
    address = client.post("/v1/jobs", json=job).raise_for_status().headers["location"]
    until(lambda: client.get(address).json()["state"] in ("succeeded", "failed"))
    done = client.get(address).json()
    assert done["state"] == "succeeded", done["error"]
    version = done["result"]["version_id"]
    rng = np.random.default_rng(8)
    q, floor = rng.uniform(-1.2, 1.2, (15, 4)) + np.array([0.0, 0.4, 1.0, 0.0]), rng.normal(0.0, 6e-4, (15, 2))
    uncorrected, tilt = settled(q, floor)

    def corrected(path: dict[str, list[float]]) -> tuple[dict[str, Any], str]:
        answer = client.post("/v1/robots/column/correct", params={"version": version}, json=path).raise_for_status()
        return answer.json(), answer.headers.get("Kilter-Not-Corrected", "")

    found, left_out = corrected(columns(q, tilt[:, 0] + ZERO_RAD, tilt[:, 1] + ZERO_RAD))
    assert left_out == ""
    good = np.array([status == "OK" for status in found["status"]])
    assert good.sum() >= 10
    removed = 1e-3 * np.column_stack([np.array(found[f"d{k}_mm"], dtype=float) for k in "xyz"])
    joints = np.radians(np.column_stack([np.array(found[f"q{j}_deg"], dtype=float) for j in range(1, 5)]))
    reached, _ = settled(joints[good], floor[good])
    assert np.median(np.linalg.norm(removed, axis=1)) > 8e-4
    assert np.linalg.norm(reached - (uncorrected - removed)[good], axis=1).max() < 1e-4
    assert corrected(columns(q, None, None))[1] == "measured_tilt"
    where = (
        "Corrected only in files and paths, whose rows must state base_tilt_x_deg and base_tilt_y_deg: measured_tilt."
    )
    active = client.post(f"/v1/versions/{version}/activate").raise_for_status().json()
    for said in (active, active["preview"], client.get(f"/v1/versions/{version}/preview").raise_for_status().json()):
        assert said["unsupported_effects"] == ["measured_tilt"]
        assert said["corrected_where_stated"] == {"measured_tilt": ["base_tilt_x_deg", "base_tilt_y_deg"]}
        assert said["not_corrected"] == where
    path = {"json": columns(q, None, None)}
    notes = client.post("/v1/robots/column/correct", **path).raise_for_status().headers["Kilter-Notes"]
    assert where in notes
    exported = client.get(f"/v1/versions/{version}/export", params={"format": "corrector"}).raise_for_status()
    told = exported.headers["Kilter-Notes"]
    assert "Not corrected by this file: measured_tilt." in told
    assert where in told
