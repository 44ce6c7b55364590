"""How a robot stands is said first on each of its views, and follows what its stream does, not its numbers alone."""

from __future__ import annotations

import html
import re
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pytest
from sqlalchemy import update

from kilter_service.contract.fits import Errors, StageErrors
from kilter_service.contract.today import CheckOfRobot, DriftSummary, ErrorsToday, Today
from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import HeartbeatRow
from kilter_service.page.shared.standing import Corrector, assess_robot_state
from kilter_service.versions.today.standing import Known, assess
from tests.service.conftest import Katana, WorkerProcess

Until = Callable[..., None]


def words(text: str) -> str:
    return html.unescape(re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", text))).strip()


def test_each_view_of_a_robot_says_how_it_stands(
    client: httpx.Client, katana: Katana, worker: WorkerProcess, until: Until
) -> None:
    name = katana.name
    client.post("/v1/robots", json=katana.document).raise_for_status()
    assert "Not calibrated" in words(client.get(f"/robots/{name}/state", headers={"hx-request": "true"}).text)
    worker.start()
    made = client.post(f"/v1/robots/{name}/campaigns", json={"name": "monday"}).raise_for_status().json()["id"]
    client.post(f"/v1/campaigns/{made}/observations", json=katana.columns(40, 1)).raise_for_status()
    asked = {"kind": "identify", "robot": name, "campaigns": [made], "validation": 0.3, "options": {"level": 1}}
    job = client.post("/v1/jobs", json=asked).raise_for_status().json()["id"]
    until(lambda: client.get(f"/v1/jobs/{job}").json()["state"] == "succeeded")
    version = client.get(f"/v1/jobs/{job}").json()["result"]["version_id"]
    client.post(f"/v1/versions/{version}/activate", json={"force": True}).raise_for_status()
    loads = f'hx-get="/robots/{name}/state" hx-trigger="load"'
    views = (
        *(f"/robots/{name}/{view}" for view in ("campaigns", "jobs", "versions", "correct", "settings")),
        f"/versions/{version}", f"/jobs/{job}", f"/campaigns/{made}",
    )  # fmt: skip
    for view in views:
        assert client.get(view).raise_for_status().text.count(loads) == 1, view
    for at_length in ("", "/stream"):  # which have a bar of their own
        assert loads not in client.get(f"/robots/{name}{at_length}").text
    part = client.get(f"/robots/{name}/state", headers={"hx-request": "true"}).raise_for_status().text
    assert not part.lstrip().lower().startswith("<!doctype")
    # The same state, number and sentence as on the overview; alone it is a page.
    overview = words(client.get(f"/robots/{name}").text)
    stated = re.search(r'<strong class="state-word">([^<]*)</strong>\s*<strong>([^<]*)</strong>', part)
    assert stated is not None
    assert all(html.unescape(one) in overview for one in stated.groups())
    assert "The corrector does not run" in words(part)
    assert client.get(f"/robots/{name}/state").text.lstrip().lower().startswith("<!doctype")
    assert client.get("/robots/nobody/state").status_code == 404


ERRORS = StageErrors(n=40, identified=Errors(mean_mm=0.05, rms_mm=0.055))


def stands(last: CheckOfRobot | None = None) -> Today:
    """A robot with good errors on rows that were held out."""
    at = datetime(2026, 4, 16, tzinfo=UTC)
    held = ErrorsToday(source="held_out", job_id="job_0", at=at, campaigns=[], refit=[], rows="", errors=ERRORS)
    today = Today(
        robot="arm", version_id="ver_1", newest=held, own=held, changed=False, larger_by_mm=None, compared="",
        not_evaluated=[], missing=None, sentences=[],
    )  # fmt: skip
    drift = DriftSummary(
        robot="arm", state="ok" if last else "never", version_id="ver_1", sentence="", checks=9, last=last, age_days=200
    )
    return today.model_copy(update={"standing": assess(today, drift, Known())})


@pytest.mark.parametrize(
    ("robot", "version", "ago_s", "word"),
    [
        ("arm", "ver_1", 1.0, "As calibrated on 16 April"),
        ("arm", "ver_0", 1.0, "Other version"),
        ("arm", None, 1.0, "Other version"),
        ("arm", "ver_0", 3600.0, "As calibrated on 16 April"),  # it ended long before the version was activated
        ("other", "ver_0", 1.0, "As calibrated on 16 April"),
    ],
)
def test_a_good_number_does_not_hide_a_stream_that_is_not_corrected_with_it(
    robot: str, version: str | None, ago_s: float, word: str
) -> None:
    told = {"robot": robot, "version_id": version, "stream": "a", "at_ns": time.time_ns() - int(ago_s * 1e9)}
    seen = Corrector("alive", "1 alive", [told]).describe_correction("arm", "ver_1")
    assert assess_robot_state(stands(), seen).word == word


def test_the_state_says_when_the_checks_were_that_agree() -> None:
    at = datetime(2026, 5, 1, 7, 0, tzinfo=UTC)
    last = CheckOfRobot(job_id="job_1", campaign_id="cmp_1", version_id="ver_1", at=at, verdict="ok", sentence="ok: as it was.",
                        p_value=0.5, temperature_c=None)  # fmt: skip
    found = assess_robot_state(stands(last), Corrector("alive", "1 alive", []).describe_correction("arm", "ver_1"))
    assert found.sentence == "Its checks agree with the version, last on 2026-05-01, 200 days ago."


@pytest.mark.parametrize("compensation", ["factory", "kilter"])
def test_a_controller_that_corrects_does_not_hide_a_bridge_that_corrects_on_top_of_it(
    client: httpx.Client, katana: Katana, compensation: str
) -> None:
    name, run = katana.name, "0123456789abcdef"
    client.post("/v1/robots", json={**katana.document, "controller_compensation": compensation}).raise_for_status()

    def heard(state: str, offset_deg: float) -> tuple[dict[str, Any], str]:
        news = {
            "kind": "rsi", "state": state, "version_id": "ver_1", "cycle_ms": 4.0, "cycles": 9, "late": 0, "lost": 0,
            "refused": 0, "offset_deg": offset_deg, "largest_offset_deg": 0.2,
        }  # fmt: skip
        told = client.put(f"/v1/robots/{name}/bridges/{run}", json=news).raise_for_status().json()
        (seen,) = client.get(f"/v1/robots/{name}/bridges").raise_for_status().json()["bridges"]
        assert (seen["corrected_twice"], seen["sentence"]) == (told["corrected_twice"], told["sentence"])
        return told, words(client.get(f"/robots/{name}/state", headers={"hx-request": "true"}).text)

    for state, offset_deg in (("correcting", 0.0), ("ramping in", 0.1), ("holding back", 0.1)):
        told, page = heard(state, offset_deg)
        assert told["corrected_twice"] is True
        assert "so the arm is corrected twice" in told["sentence"]
        assert page.startswith("Corrected twice"), page
        assert "Stop the bridge" in page
    for state in ("off", "waiting", "ended"):
        told, page = heard(state, 0.0)
        assert told["corrected_twice"] is False
        assert page.startswith("By its controller"), page
    heard("correcting", 0.1)
    client.patch(f"/v1/robots/{name}", json={"controller_compensation": "none"}).raise_for_status()
    told, page = heard("correcting", 0.1)  # what the sentence says to do ends it
    assert told["corrected_twice"] is False
    assert not page.startswith("Corrected twice"), page


def test_a_bridge_that_is_no_longer_heard_is_told_though_the_controller_corrects(
    client: httpx.Client, katana: Katana, database: Database
) -> None:
    name = katana.name
    client.post("/v1/robots", json={**katana.document, "controller_compensation": "factory"}).raise_for_status()

    def heard(run: str, state: str, offset_deg: float, ago_s: float) -> tuple[dict[str, Any], str]:
        news = {
            "kind": "rsi", "state": state, "version_id": "ver_1", "cycle_ms": 4.0, "cycles": 9, "late": 0, "lost": 0,
            "refused": 0, "offset_deg": offset_deg, "largest_offset_deg": 0.2,
        }  # fmt: skip
        client.put(f"/v1/robots/{name}/bridges/{run}", json=news).raise_for_status()
        with database.transaction() as session:
            session.execute(
                update(HeartbeatRow)
                .where(HeartbeatRow.name.endswith(run))
                .values(at=datetime.now(UTC) - timedelta(seconds=ago_s))
            )
        found = client.get(f"/v1/robots/{name}/bridges").raise_for_status().json()["bridges"][0]
        return found, words(client.get(f"/robots/{name}/state", headers={"hx-request": "true"}).text)

    run = "0123456789abcdef"
    for state in ("correcting", "killed"):
        told, page = heard(run, state, 0.1, 300.0)
        assert (told["gone"], told["corrected_twice"]) == (True, False)
        assert "5 min ago" in told["sentence"]
        assert "if the bridge still offsets the joints, the arm is corrected twice" in told["sentence"]
        assert page.startswith("Perhaps twice"), page
        assert told["sentence"] in page
    told, page = heard(run, "waiting", 0.0, 300.0)  # it offset nothing
    assert page.startswith("By its controller"), page
    heard(run, "correcting", 0.1, 300.0)
    told, page = heard("fedcba9876543210", "ended", 0.0, 1.0)  # what the docs say to do ends it
    assert told["state"] == "ended"
    assert page.startswith("By its controller"), page
