"""Budgets of uncertainty in the results of jobs, and the same ones wherever they are shown."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import pytest

from tests.service.conftest import Katana, WorkerProcess

Until = Callable[..., None]
TRACKER = {
    "name": "tracker",
    "kind": "laser_tracker",
    "serial_number": "1",
    "mpe_standard": "iso_10360_10",
    "mpe_um": 15.0,
    "mpe_um_per_m": 6.0,
}
PARTS = ["instrument", "repeatability", "registration", "temperature", "model", "left_over"]


def done(client: httpx.Client, until: Until, **request: Any) -> dict[str, Any]:
    job = client.post("/v1/jobs", json={"robot": "katana", **request}).raise_for_status().json()["id"]
    state: dict[str, Any] = {}

    def ended() -> bool:
        state.update(client.get(f"/v1/jobs/{job}").json())
        assert state["state"] != "failed", state["error"]
        return state["state"] == "succeeded"

    until(ended, 90)
    return state


def campaign(client: httpx.Client, katana: Katana, name: str, rows: int, seed: int, **more: Any) -> str:
    made = client.post("/v1/robots/katana/campaigns", json={"name": name, **more}).raise_for_status().json()["id"]
    client.post(f"/v1/campaigns/{made}/observations", json=katana.columns(rows, seed)).raise_for_status()
    return str(made)


def sources(budget: dict[str, Any]) -> set[str]:
    assert sorted([*(one["source"] for one in budget["contributions"]), *budget["not_assessed"]]) == sorted(PARTS)
    return {one["source"] for one in budget["contributions"]}


def test_results_have_budgets_and_today_shows_the_same(
    client: httpx.Client, katana: Katana, worker: WorkerProcess, until: Until
) -> None:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    client.post("/v1/instruments", json=TRACKER).raise_for_status()
    first = campaign(client, katana, "first", 60, 1, instrument="tracker")
    worker.start()
    made = done(client, until, kind="identify", campaigns=[first], validation=0.25, options={"level": 2})["result"]
    for block, rows in (("train", 45), ("validation", 15)):
        budget = made["metrics"][block]["budget"]
        assert (budget["rows"], budget["instrument"], budget["k"]) == (rows, "tracker", 2.0)
        assert {"instrument", "registration", "model"} <= sources(budget)
        assert budget["expanded_mm"] == pytest.approx(2.0 * budget["standard_mm"])
        total = sum(one["standard_mm"] ** 2 for one in budget["contributions"])
        assert budget["standard_mm"] ** 2 == pytest.approx(total, rel=1e-9)
        (instrument,) = [one for one in budget["contributions"] if one["source"] == "instrument"]
        assert 0.015 < instrument["half_width_mm"] < 0.015 + 0.006  # within a metre
    version = client.get(f"/v1/versions/{made['version_id']}").json()
    assert version["metrics"]["validation"]["budget"] == made["metrics"]["validation"]["budget"]

    client.post(f"/v1/versions/{made['version_id']}/activate").raise_for_status()
    assert client.get("/v1/robots/katana/today").json()["newest"]["errors"]["budget"]["rows"] == 15
    second = campaign(client, katana, "second", 30, 2)
    found = done(client, until, kind="evaluate", campaigns=[second])["result"]["metrics"][second]["budget"]
    assert (found["instrument"], "instrument" in found["not_assessed"]) == (None, True)
    assert client.get("/v1/robots/katana/today").json()["newest"]["errors"]["budget"] == found
    refit = done(client, until, kind="evaluate", campaigns=[second], options={"refit": ["base", "tool"]})
    apart = refit["result"]["metrics"][second]["budget"]
    sizes = {one["source"]: one["standard_mm"] for one in apart["contributions"]}
    assert sizes["registration"] > 0.0


def test_of_several_campaigns_the_coarsest_instrument_counts(
    client: httpx.Client, katana: Katana, worker: WorkerProcess, until: Until
) -> None:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    client.post("/v1/instruments", json=TRACKER).raise_for_status()
    client.post("/v1/instruments", json={**TRACKER, "name": "older", "mpe_um": 30.0}).raise_for_status()
    ids = [campaign(client, katana, n, 30, k, instrument=n) for k, n in enumerate(("tracker", "older"), 1)]
    worker.start()
    made = done(client, until, kind="identify", campaigns=ids, options={"level": 2})["result"]
    assert made["metrics"]["train"]["budget"]["instrument"] == "older"
    assert made["metrics"]["validation"] is None
    plain = campaign(client, katana, "plain", 30, 3)
    made = done(client, until, kind="identify", campaigns=[*ids, plain], validation={"folds": 3}, options={"level": 2})
    metrics = made["result"]["metrics"]
    assert metrics["train"]["budget"]["instrument"] is None
    assert metrics["validation"]["budget"]["rows"] == 90
