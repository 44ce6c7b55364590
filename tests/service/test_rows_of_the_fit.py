"""Rows that a fit used prove nothing, in whatever file they come; those that it held out do: checks, decisions, today."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence

import httpx
import numpy as np
import pytest
from sqlalchemy import select, text

from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import VersionRow
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
    rounded = {name: [round(value, 6) for value in values] for name, values in changed.items()}
    tricks = {"other units": changed, "one among new ones": mixed, "rounded to a micrometre": rounded}
    for name, rows in tricks.items():
        body = {"robot": "katana", "kind": kind, "campaigns": [fit], "validation": [sent(client, name, rows)]}
        made = client.post("/v1/jobs", json=body).raise_for_status().json()["id"]
        until(lambda made=made: client.get(f"/v1/jobs/{made}").json()["state"] in ("succeeded", "failed"))
        assert (client.get(f"/v1/jobs/{made}").json()["error"] or {}).get("code") == "rows_shared", name
        previewed = client.post("/v1/jobs/check", json=body).raise_for_status().json()
        assert "rows_shared" in [one["code"] for one in previewed["problems"]], name


@pytest.mark.parametrize("kind", ["identify", "gap"])
def test_rows_of_the_start_do_not_validate_what_continues_it(
    client: httpx.Client, katana: Katana, worker: WorkerProcess, until: Until, fitted: list[bool], kind: str
) -> None:
    start = today(client)["version_id"]
    (used,) = {one["id"] for one in client.get(f"/v1/versions/{start}").json()["campaigns"]}
    other = sent(client, "other rows", katana.columns(40, seed=4))
    body = {"robot": "katana", "kind": kind, "campaigns": [other], "validation": [used], "options": {"start": start}}
    made = client.post("/v1/jobs", json=body).raise_for_status().json()["id"]
    until(lambda: client.get(f"/v1/jobs/{made}").json()["state"] in ("succeeded", "failed"))
    error = client.get(f"/v1/jobs/{made}").json()["error"]
    assert (error or {}).get("code") == "rows_shared"
    assert start in error["message"]
    previewed = client.post("/v1/jobs/check", json=body).raise_for_status().json()
    assert "rows_shared" in [one["code"] for one in previewed["problems"]]


def test_a_version_judged_by_its_own_rows_is_said_to_be_so(
    client: httpx.Client, katana: Katana, worker: WorkerProcess, until: Until, database: Database
) -> None:
    first, other = katana.campaign(client, ROWS), sent(client, "other", katana.columns(20, seed=4))
    worker.start()
    body = {"campaigns": [first], "validation": [other], "options": {"level": 2}}
    made = done(client, until, kind="identify", **body)["result"]
    client.post(f"/v1/versions/{made['version_id']}/activate").raise_for_status()
    assert today(client)["newest"]["source"] == "held_out"
    with database.transaction() as session:  # as earlier releases stored it
        where = VersionRow.id == made["version_id"]
        (train,) = (
            one for one in session.scalars(select(VersionRow.campaigns).where(where)).one() if one["use"] == "train"
        )
        stored = {"used": json.dumps([train, {**train, "use": "validation"}]), "id": made["version_id"]}
        session.execute(text("UPDATE versions SET campaigns = :used WHERE id = :id"), stored)
    assert today(client)["newest"]["source"] == "fitted"


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
