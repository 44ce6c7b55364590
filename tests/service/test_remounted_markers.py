"""A marker that was mounted anew between two campaigns, over HTTP: in the result, in its warnings and in the residuals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import numpy as np

from tests.core.identify.test_own_tools import NOISE_MM, Lab
from tests.core.truth import ur10


def test_campaigns_with_remounted_markers_are_identified_together(
    client: httpx.Client, worker: Any, until: Callable[..., None]
) -> None:
    lab = Lab(0.02)
    arm = ur10(tool=lab.actual.tool)
    client.post("/v1/robots", json=arm.document() | {"name": "arm"}).raise_for_status()
    campaigns = []
    for code, new in ((1, False), (2, True)):
        rows = lab.rows(code, 50, new=new)
        assert rows.position is not None
        table = {f"q{j + 1}_deg": np.degrees(rows.q[:, j]).tolist() for j in range(6)}
        table |= {f"{k}_mm": (1e3 * rows.position[:, i]).tolist() for i, k in enumerate("xyz")}
        made = client.post("/v1/robots/arm/campaigns", json={"name": f"day {code}"}).raise_for_status().json()["id"]
        client.post(f"/v1/campaigns/{made}/observations", json=table).raise_for_status()
        campaigns.append(made)
    worker.start()
    job = {"kind": "identify", "robot": "arm", "campaigns": campaigns, "options": {"refit": ["tool"], "noise_mm": 0.02}}
    address = client.post("/v1/jobs", json=job).raise_for_status().headers["location"]
    until(lambda: client.get(address).json()["state"] in ("succeeded", "failed"))
    done = client.get(address).json()
    assert done["state"] == "succeeded", done["error"]
    result = done["result"]
    assert result["base_refitted"] == []
    (own,) = result["tool_refitted"]
    assert (own["campaign"], own["use"]) == (campaigns[1], "train")
    assert own["moved_mm"] > 5.0
    assert result["metrics"]["train"]["identified"]["rms_mm"] < 1.3 * NOISE_MM
    warning = next(w for w in result["warnings"] if w["code"] == "tool_refitted")
    assert warning["campaigns"] == [campaigns[1]]
    left = (
        client.get(f"/v1/versions/{result['version_id']}/residuals", params={"format": "json"})
        .raise_for_status()
        .json()
    )
    size = np.linalg.norm([np.array(left[f"d{k}_mm"], dtype=float) for k in "xyz"], axis=0)
    assert len(size) == 100
    for own_rows in (size[:50], size[50:]):
        assert np.sqrt(np.mean(own_rows**2)) < 1.4 * NOISE_MM
