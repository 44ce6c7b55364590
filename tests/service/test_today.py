"""How good a robot is today: real jobs on a robot that crashes; page, HTTP, library and command say the same."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Any

import httpx
import numpy as np
import pytest
from sqlalchemy import select

from kilter_client import Kilter
from kilter_client.cli.reports.results import show_today
from kilter_service.ground.db import Database
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import CampaignRow, JobRow, RobotRow
from tests.service.conftest import Katana, WorkerProcess

Until = Callable[..., None]
CRASH_DEG, AWAY_MM = 0.4, 2540.0
ECCENTRICITY = {
    "id": "eccentricity", "joints": [2], "verdict": "class_confirmed", "class": "gravity_spring",
    "alias_set": [{"id": "gravity_spring", "joints": [2]}],
}  # fmt: skip


def sent(client: httpx.Client, name: str, columns: dict[str, list[float]]) -> str:
    body = {"name": name}
    campaign = client.post(f"/v1/robots/katana/campaigns", json=body).raise_for_status().json()["id"]  # noqa: F541
    client.post(f"/v1/campaigns/{campaign}/observations", json=columns).raise_for_status()
    return str(campaign)


def done(client: httpx.Client, until: Until, **job: Any) -> dict[str, Any]:
    made = client.post("/v1/jobs", json={"robot": "katana", **job}).raise_for_status().json()["id"]
    read = lambda: client.get(f"/v1/jobs/{made}").json()  # noqa: E731
    until(lambda: read()["state"] in ("succeeded", "failed"))
    assert read()["state"] == "succeeded", read()["error"]
    return dict(read())


def words(client: httpx.Client, address: str) -> str:
    text = client.get(address).raise_for_status().text
    return html.unescape(re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", text)))


def today(client: httpx.Client) -> dict[str, Any]:
    return dict(client.get("/v1/robots/katana/today").raise_for_status().json())


def searched(database: Database, effects: list[dict[str, Any]], later: int = 60) -> str:
    """Store a search that was completed, as a worker does, and jobs of other kinds that came after it."""
    result = {"verdict": "closed", "sentence": "eccentricity of joint 2: confirmed.", "effects": effects, "start": None}
    with database.transaction() as session:
        robot = session.execute(select(RobotRow.id).where(RobotRow.name == "katana")).scalar_one()
        for number in range(later + 1):
            kind, state = ("plan", "cancelled") if number else ("gap", "succeeded")
            request = {"kind": kind, "robot": "katana", "campaigns": [], "validation": None, "options": {}}
            at = utc_now() + timedelta(seconds=number)
            session.add(
                JobRow(
                    id=f"job_{number:016x}", kind=kind, robot_id=robot, request=request, state=state, created_at=at,
                    finished_at=at, result=None if number else result,
                )
            )  # fmt: skip
    return f"job_{0:016x}"


def test_after_a_crash_every_surface_says_the_error_of_the_newest_rows(
    client: httpx.Client, katana: Katana, worker: WorkerProcess, until: Until, capsys: pytest.CaptureFixture[str]
) -> None:
    first = katana.campaign(client, 60)
    assert today(client)["version_id"] is None
    worker.start()
    made = done(client, until, kind="identify", campaigns=[first], validation=0.25, options={"level": 2})["result"]
    client.post(f"/v1/versions/{made['version_id']}/activate").raise_for_status()
    held = made["metrics"]["validation"]["identified"]["mean_mm"]
    found = today(client)
    assert (found["newest"]["source"], found["changed"]) == ("held_out", False)
    assert found["newest"]["errors"]["identified"]["mean_mm"] == held

    # An evaluation on what was fitted is no number of today, however new it is.
    done(client, until, kind="evaluate", campaigns=[first])
    assert today(client)["newest"]["source"] == "held_out"

    crashed = katana.columns(40, seed=5)
    crashed["q2_deg"] = (np.asarray(crashed["q2_deg"]) - CRASH_DEG).tolist()
    after = sent(client, "after the crash", crashed)
    assert [one["id"] for one in today(client)["not_evaluated"]] == [after]
    assert "not evaluated" in words(client, "/robots/katana")

    judged = done(client, until, kind="evaluate", campaigns=[after])
    mean = judged["result"]["metrics"][after]["identified"]["mean_mm"]
    assert mean > 2 * held  # the crash is there
    found = today(client)
    assert found["newest"]["source"] == "evaluation"
    assert found["newest"]["job_id"] == judged["id"]
    assert [one["name"] for one in found["newest"]["campaigns"]] == ["after the crash"]
    assert found["newest"]["errors"]["identified"]["mean_mm"] == mean
    assert found["changed"]
    assert found["larger_by_mm"] == pytest.approx(mean - held)
    assert found["not_evaluated"] == []
    date = found["newest"]["campaigns"][0]["measured_at"][:10]
    for page in ("/", "/robots/katana"):
        said = words(client, page)
        assert f"{mean:.3g}" in said, page
        assert re.search(rf"after the crash ?, sent on {date}, today \(when it was measured is not stated\)", said), (
            page
        )
        assert "more than chance explains" in said, page
    with Kilter(str(client.base_url), client.headers["authorization"].removeprefix("Bearer ")) as kilter:
        assert kilter.today("katana").newest.errors.identified.mean_mm == mean
        show_today(kilter.robots.today("katana"))
    errors = found["newest"]["errors"]
    half = 1.96 * math.sqrt((errors["identified"]["rms_mm"] ** 2 - mean**2) / (errors["n"] - 1))
    ends = f"95 % interval {mean - half:.2f} mm to {mean + half:.2f} mm"
    said = f"Mean error {mean:.3g} mm ({ends}) on rows that no fit used: campaign after the crash, sent on "
    for page in ("/", "/robots/katana"):  # the same as the command says
        assert ends in words(client, page), page
    assert said in capsys.readouterr().out

    # Rows that nobody may use any more say nothing.
    client.post(f"/v1/campaigns/{after}/retire").raise_for_status()
    assert today(client)["newest"]["source"] == "held_out"


def test_where_the_tracker_stands_is_no_error_of_the_arm(
    client: httpx.Client, katana: Katana, worker: WorkerProcess, until: Until
) -> None:
    columns = katana.columns(60, seed=2)
    columns["x_mm"] = (np.asarray(columns["x_mm"]) + AWAY_MM).tolist()
    katana.campaign(client, 5)
    away = sent(client, "tracker", columns)
    worker.start()
    job = done(client, until, kind="identify", campaigns=[away], validation=0.25, options={"level": 2})
    made = job["result"]
    assert made["metrics"]["validation"]["nominal"]["mean_mm"] > 2500
    version = made["version_id"]
    client.post(f"/v1/versions/{version}/activate", json={"force": True, "reason": "test"}).raise_for_status()
    said = words(client, "/robots/katana")
    assert "Without the version" not in said
    plain = made["metrics"]["validation"]["registration_only"]["mean_mm"]
    assert f"With base and tool measured anew alone it would be {plain:.3g} mm" in said
    assert "is where instrument, base and tool are, not an error of the arm" in said
    for address in (f"/versions/{version}", f"/versions/{version}/report", f"/jobs/{job['id']}"):
        assert "mostly where instrument, base and tool are" in words(client, address), address


@pytest.mark.both_databases
def test_what_is_missing_is_asked_of_the_store_and_of_the_active_version(
    client: httpx.Client, database: Database, katana: Katana, worker: WorkerProcess, until: Until
) -> None:
    campaign = katana.campaign(client, 60)
    search = searched(database, [ECCENTRICITY])
    found = today(client)["missing"]
    assert found["job_id"] == search
    assert "Nothing corrects yet what the search of" in found["sentence"]
    worker.start()
    without = done(client, until, kind="identify", campaigns=[campaign], options={"effects": ["encoder_scale"]})[
        "result"
    ]["version_id"]
    client.post(f"/v1/versions/{without}/activate", json={"force": True, "reason": "test"}).raise_for_status()
    found = today(client)["missing"]
    assert [one["corrected"] for one in found["named"]] == [False]
    lacks = "eccentricity or gravity spring of joint 2"  # the words of the headline
    assert f"Missing in the active version: {lacks}" in found["sentence"]
    assert lacks in words(client, "/robots/katana")

    effect = {"id": "eccentricity", "joints": [2]}
    fit = {"effects": [effect]}
    having = done(client, until, kind="identify", campaigns=[campaign], options=fit)["result"]["version_id"]
    client.post(f"/v1/versions/{having}/activate", json={"force": True, "reason": "test"}).raise_for_status()
    found = today(client)["missing"]
    assert [one["corrected"] for one in found["named"]] == [True]
    assert "Missing" not in found["sentence"]
    assert found["sentence"] in words(client, "/robots/katana")
    client.post(f"/v1/versions/{without}/activate", json={"force": True, "reason": "test"}).raise_for_status()
    assert "Missing" in today(client)["missing"]["sentence"]


@pytest.mark.both_databases
def test_today_says_when_rows_were_measured_and_where_only_their_upload_is_known(
    client: httpx.Client, database: Database, katana: Katana, worker: WorkerProcess, until: Until
) -> None:
    first = katana.campaign(client, 60)
    worker.start()
    made = done(client, until, kind="identify", campaigns=[first], validation=0.25, options={"level": 2})["result"]
    client.post(f"/v1/versions/{made['version_id']}/activate").raise_for_status()
    newest = today(client)["newest"]["campaigns"][0]
    assert (newest["stated"], newest["age_days"]) == (False, 0)
    assert "(when it was measured is not stated)" in newest["when"]

    at = utc_now() - timedelta(days=22, hours=1)
    later = "2031-11-02T00:00:00+00:00"
    refused = client.post("/v1/robots/katana/campaigns", json={"name": "tomorrow", "measured_at": later})
    assert refused.status_code == 422
    assert "is in the future" in refused.json()["detail"]
    without = client.post("/v1/robots/katana/campaigns", json={"name": "naive", "measured_at": "2026-11-02T00:00:00"})
    assert without.status_code == 422
    with Kilter(str(client.base_url), client.headers["authorization"].removeprefix("Bearer ")) as kilter:
        sent = kilter.upload("katana", katana.columns(40, seed=7), name="old", measured_at=at, progress=False)
        old = sent.campaign_id
        assert kilter.campaign(old).measured_at is not None
    told = client.get(f"/v1/campaigns/{old}").json()
    assert datetime.fromisoformat(told["measured_at"]) == at
    # Rows of before the fit, sent after it: no news of today, and nothing that waits to be evaluated.
    assert today(client)["not_evaluated"] == []
    done(client, until, kind="evaluate", campaigns=[old])
    found = today(client)
    assert found["newest"]["source"] == "held_out"

    client.post(f"/v1/campaigns/{first}/retire").raise_for_status()
    with database.reading() as session:
        assert session.execute(select(CampaignRow.measured_at).where(CampaignRow.id == old)).scalar_one() == at


def test_what_is_left_of_a_campaign_is_no_other_measurement(
    client: httpx.Client, katana: Katana, worker: WorkerProcess, until: Until
) -> None:
    """Rows that were set aside leave another campaign: it waits for no evaluation, and a fit to it is a fit to the whole."""
    first = katana.campaign(client, 60)
    worker.start()
    made = done(client, until, kind="identify", campaigns=[first], validation=0.25, options={"level": 2})["result"]
    client.post(f"/v1/versions/{made['version_id']}/activate").raise_for_status()

    def left(campaign: str, rows: str) -> str:
        client.post(f"/campaigns/{campaign}/rows/aside", data={"rows": rows}, follow_redirects=False)
        return str(client.get("/v1/robots/katana/campaigns", params={"limit": 1000}).json()["campaigns"][-1]["id"])

    of_fitted = left(first, "1-3")
    assert client.get(f"/v1/campaigns/{of_fitted}").json()["rows"] == 57
    assert today(client)["not_evaluated"] == []
    done(client, until, kind="evaluate", campaigns=[of_fitted])
    assert today(client)["newest"]["source"] == "held_out"  # its rows were fitted

    later = sent(client, "later", katana.columns(40, seed=7))
    of_later = left(later, "7")
    assert [one["id"] for one in today(client)["not_evaluated"]] == [later]
    client.post(f"/v1/campaigns/{later}/retire").raise_for_status()
    assert [one["id"] for one in today(client)["not_evaluated"]] == [of_later]
