"""Rows that a fit used prove nothing, in whatever file they come; those that it held out do: checks, decisions, today."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import httpx
import numpy as np
import pytest

from tests.service.conftest import Katana, WorkerProcess
from tests.service.test_today import done, sent, today

Until = Callable[..., None]
ROWS = 60


@pytest.fixture
def fitted(client: httpx.Client, katana: Katana, worker: WorkerProcess, until: Until) -> list[bool]:
    """Which rows of the campaign that the active version is of were fitted."""
    first = katana.campaign(client, ROWS)
    worker.start()
    made = done(client, until, kind="identify", campaigns=[first], validation=0.25, options={"level": 2})["result"]
    client.post(f"/v1/versions/{made['version_id']}/activate").raise_for_status()
    asked = {"campaign": first, "format": "json"}
    table = client.get(f"/v1/versions/{made['version_id']}/residuals", params=asked).raise_for_status().json()
    held = np.zeros(ROWS, dtype=bool)
    held[np.asarray(table["row"]) - 1] = table["held_out"]
    assert held.sum() == ROWS // 4
    return [bool(one) for one in ~held]


def some(columns: dict[str, list[float]], rows: Sequence[int]) -> dict[str, list[float]]:
    return {name: [values[k] for k in rows] for name, values in columns.items()}


def failed(client: httpx.Client, until: Until, campaign: str) -> str:
    body = {"robot": "katana", "kind": "drift", "campaigns": [campaign]}
    made = client.post("/v1/jobs", json=body).raise_for_status().json()["id"]
    read = lambda: client.get(f"/v1/jobs/{made}").json()  # noqa: E731
    until(lambda: read()["state"] in ("succeeded", "failed"))
    assert read()["state"] == "failed", read()["result"]
    return str(read()["error"]["code"])


@pytest.mark.parametrize("kind", ["identify", "gap"])
def test_fitted_rows_in_another_file_do_not_validate(
    client: httpx.Client, katana: Katana, worker: WorkerProcess, until: Until, kind: str
) -> None:
    fit, columns, other = katana.campaign(client, ROWS), katana.columns(ROWS), katana.columns(9, seed=4)
    worker.start()
    few = some(columns, [7, 3, 40])
    units = {"_mm": ("_m", 1e-3), "_deg": ("_rad", np.pi / 180)}
    changed = {}
    for name, values in few.items():
        stem, unit = name.split("_")
        ending, scale = units[f"_{unit}"]
        changed[f"{stem}{ending}"] = [value * scale for value in values]
    mixed = {name: [*other[name], columns[name][5]] for name in columns}
    for name, rows in {"other units": changed, "one among new ones": mixed}.items():
        body = {"robot": "katana", "kind": kind, "campaigns": [fit], "validation": [sent(client, name, rows)]}
        made = client.post("/v1/jobs", json=body).raise_for_status().json()["id"]
        until(lambda made=made: client.get(f"/v1/jobs/{made}").json()["state"] in ("succeeded", "failed"))
        assert (client.get(f"/v1/jobs/{made}").json()["error"] or {}).get("code") == "rows_shared", name
        previewed = client.post("/v1/jobs/check", json=body).raise_for_status().json()
        assert "rows_shared" in [one["code"] for one in previewed["problems"]], name


def decided(client: httpx.Client, campaign: str) -> httpx.Response:
    return client.get("/v1/robots/katana/acceptance", params={"tolerance_mm": 5.0, "campaign": campaign})


def test_copies_of_fitted_rows_prove_nothing(
    client: httpx.Client, katana: Katana, until: Until, fitted: list[bool]
) -> None:
    columns, other = katana.columns(ROWS), katana.columns(9, seed=4)
    used = np.flatnonzero(fitted)
    mixed = {name: [*other[name], columns[name][used[3]]] for name in columns}
    tricks = {
        "another name": (columns, used.size),
        "reordered": (some(columns, np.random.default_rng(1).permutation(ROWS).tolist()), used.size),
        "a subset": (some(columns, used[:10].tolist()), 10),
        "one among new ones": (mixed, 1),
    }
    for name, (rows, count) in tricks.items():
        campaign = sent(client, name, rows)
        assert failed(client, until, campaign) == "rows_shared", name
        judged = done(client, until, kind="evaluate", campaigns=[campaign])["result"]
        assert judged["metrics"][campaign]["fitted"] == count, name
        assert "rows_fitted" in [one["code"] for one in judged["warnings"]], name
        assert today(client)["newest"]["source"] == "held_out", name
        answer = decided(client, campaign)
        if count == len(rows["x_mm"]):
            assert (answer.status_code, answer.json()["code"]) == (409, "nothing_held_out"), name
        else:
            assert answer.raise_for_status().json()["rows"] == len(rows["x_mm"]) - count, name


def test_what_a_fit_held_out_serves_as_a_part_of_its_own(
    client: httpx.Client, katana: Katana, until: Until, fitted: list[bool]
) -> None:
    free = [k for k, one in enumerate(fitted) if not one]
    campaign = sent(client, "the rest", some(katana.columns(ROWS), free))
    assert done(client, until, kind="drift", campaigns=[campaign])["result"]["poses"] == len(free)
    judged = done(client, until, kind="evaluate", campaigns=[campaign])["result"]
    assert (judged["metrics"][campaign]["fitted"], judged["warnings"]) == (0, [])
    assert today(client)["newest"]["source"] == "evaluation"
    assert decided(client, campaign).raise_for_status().json()["rows"] == len(free)
