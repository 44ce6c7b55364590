"""Jobs on the page: checked before they run, followed while they run, and their results as the interface gives them."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, expect

from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.page.jobs.routes import NEW_JOB, parse_new_job
from kilter_service.page.words import format_with_uncertainty, mm
from kilter_service.run.app import create_app
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import Katana, WorkerProcess, new_database, ready, served, wait_for

from .conftest import opened

FINAL = ("succeeded", "failed", "cancelled")
ROBOT = Katana.name
JOBS = f"/robots/{ROBOT}/jobs"
NASTY = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Iterator[Settings]:
    """Where the server and its worker keep everything."""
    with new_database() as url:
        settings = Settings(data=tmp_path_factory.mktemp("jobs"), database_url=url, host="127.0.0.1", token=None)
        ready(settings, migrated)
        yield settings


@pytest.fixture(scope="module")
def server(place: Settings) -> Iterator[httpx.Client]:
    """The API process, without a worker at first."""
    with served(create_app(place)) as client:
        client.headers["Authorization"] = f"Bearer {admin_token(place)}"
        yield client


@pytest.fixture(scope="module")
def campaign(server: httpx.Client) -> str:
    return Katana().campaign(server, 60)


@pytest.fixture(scope="module")
def done(server: httpx.Client, place: Settings, campaign: str) -> dict[str, dict[str, Any]]:
    """Finished jobs by kind, computed by a worker of its own process."""
    plan = {"purpose": "identify", "count": 20}
    asked = [
        {
            "kind": "identify",
            "name": NASTY,
            "validation": 0.25,
            "options": {"effects": ["axial_compliance"], "loss": "tukey"},
        },
        {"kind": "evaluate", "options": {}},
        {"kind": "plan", "options": plan},
    ]
    database = Database(place.database)
    worker = WorkerProcess(place, database)
    jobs = {}
    worker.start()
    try:
        for job in asked:
            body = {"robot": ROBOT, "campaigns": [campaign], **job}
            address = server.post("/v1/jobs", json=body).raise_for_status().headers["location"]
            wait_for(lambda address=address: server.get(address).json()["state"] in FINAL)
            jobs[job["kind"]] = server.get(address).json()
            assert jobs[job["kind"]]["state"] == "succeeded", jobs[job["kind"]]["error"]
    finally:
        worker.stop()
        database.close()
    return jobs


def texts(campaign: str, **more: str) -> dict[str, str]:
    """What the form of an identification sends."""
    return {"kind": "identify", f"use.{campaign}": "train", "held_out": "fraction", "held_out_value": "0.25", **more}


def part(server: httpx.Client, address: str, data: dict[str, str]) -> httpx.Response:
    """Send a form as htmx does."""
    return server.post(address, data=data, headers={"HX-Request": "true"})


def checked(server: httpx.Client, data: dict[str, str]) -> str:
    """Check a form; returns the seal."""
    answer = part(server, f"{JOBS}/check", data)
    assert answer.status_code == 200, answer.text
    found = re.search(r'name="seal" value="([0-9a-f]{64})"', answer.text)
    assert found, answer.text
    return found[1]


def test_run_takes_what_was_checked_and_nothing_else(server: httpx.Client, campaign: str) -> None:
    data = texts(campaign)
    seal = checked(server, data)
    for changed in (data, {**data, "seal": seal, "held_out_value": "0.3"}, {**data, "seal": "0" * 64}):
        refused = part(server, JOBS, changed)
        assert refused.status_code == 400
        assert "No check has passed for exactly these inputs" in refused.text
    before = len(server.get("/v1/jobs").json()["jobs"])
    queued = part(server, JOBS, {**data, "seal": seal})
    address = queued.headers["hx-redirect"]
    found = server.get(f"/v1{address}").json()
    assert (found["kind"], found["campaigns"], found["validation"]) == ("identify", [campaign], 0.25)
    assert len(server.get("/v1/jobs").json()["jobs"]) == before + 1
    assert part(server, f"{address}/cancel", {}).headers["hx-redirect"] == address
    assert server.get(f"/v1{address}").json()["state"] == "cancelled"


def test_a_waiting_job_says_its_place_and_again_is_as_it_was_asked(server: httpx.Client, campaign: str) -> None:
    def ask(kind: str, **more: Any) -> str:
        job = {"kind": kind, "robot": ROBOT, "campaigns": [campaign], **more}
        return str(server.post("/v1/jobs", json=job).raise_for_status().json()["id"])

    gap = ask("gap")  # a queue of its own
    options = {"effects": ["axial_compliance"], "noise_mm": 0.02, "tilt_first": True}
    jobs = [ask("identify"), ask("identify", validation={"folds": 4}, options=options)]
    for job, said in (
        (gap, "It is the next one."),
        (jobs[0], "It is the next one."),
        (jobs[1], "1 job waits before it."),
    ):
        assert said in server.get(f"/jobs/{job}").text
    assert "1 before it" in server.get(f"{JOBS}?kind=plan").text
    address = html.unescape(re.findall(rf'href="({JOBS}\?[^"]+)"', server.get(f"/jobs/{jobs[1]}").text)[0])
    form = server.get(address).text
    assert '<option value="folds" selected>' in form
    for value in ("4", "axial_compliance", "0.02"):
        assert f'value="{value}"' in form
    assert "<option selected>true</option>" in form
    for job in (gap, *jobs):
        server.post(f"/v1/jobs/{job}/cancel").raise_for_status()
    assert "before it began" in server.get(f"/jobs/{gap}").text


def test_campaigns_are_preset_by_what_they_are_meant_for(server: httpx.Client, campaign: str) -> None:
    made = server.post(f"/v1/robots/{ROBOT}/campaigns", json={"name": "judge", "role": "validation"}).json()["id"]
    server.post(f"/v1/campaigns/{made}/observations", json=Katana().columns(12, seed=60)).raise_for_status()

    def preset(address: str, one: str) -> str:
        chosen = server.get(address).text.partition(f'name="use.{one}"')[2].partition("</select>")[0]
        return next(iter(re.findall(r'value="(\w*)" selected', chosen)), "")

    assert [preset(f"{JOBS}?kind={kind}", made) for kind in ("identify", "gap", "evaluate", "plan")] == [
        "validation", "validation", "train", "",
    ]  # fmt: skip
    assert preset(JOBS, campaign) == "train"
    assert preset(f"{JOBS}?campaigns={campaign}", made) == ""  # the address says all that is used


def test_a_check_is_over_when_its_campaign_has_more_rows(server: httpx.Client) -> None:
    arm = Katana()
    grown = arm.campaign(server, 40, seed=7)
    data = texts(grown)
    seal = checked(server, data)
    server.post(f"/v1/campaigns/{grown}/observations", json=arm.columns(20, seed=8)).raise_for_status()
    refused = part(server, JOBS, {**data, "seal": seal})
    assert "a campaign has changed since" in refused.text
    address = part(server, JOBS, {**data, "seal": checked(server, data)}).headers["hx-redirect"]
    server.post(f"/v1{address}/cancel").raise_for_status()


def test_a_check_says_each_thing_once(server: httpx.Client, campaign: str) -> None:
    said = server.post("/v1/jobs/check", json={"kind": "identify", "robot": ROBOT, "campaigns": [campaign]}).json()
    shown = part(server, f"{JOBS}/check", {"kind": "identify", f"use.{campaign}": "train"}).text
    unknown = [one["name"] for one in said["identifiability"]["not_identifiable"]]
    assert unknown
    for name in {*unknown, *(one["what"] for one in said["missing"])}:
        assert shown.count(f'<th scope="row">{html.escape(name)}</th>') == 1, name


def test_a_job_that_would_fail_gets_no_seal(server: httpx.Client) -> None:
    few = Katana().campaign(server, 4, seed=9)
    answer = part(server, f"{JOBS}/check", {"kind": "identify", f"use.{few}": "train"})
    said = server.post("/v1/jobs/check", json={"kind": "identify", "robot": ROBOT, "campaigns": [few]}).json()
    assert not said["would_run"]
    assert html.escape(said["problems"][0]["message"], quote=True)[:40] in answer.text.replace("&#39;", "&#x27;")
    assert 'name="seal"' not in answer.text


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"option.noise_mm": "some"}, "noise_mm"),
        ({"option.noise_mm": "-1"}, "noise_mm"),
        ({"option.effects": "ghost"}, "ghost"),
        ({"held_out_value": "a lot"}, "fraction from 0 to 1"),
        ({"kind": "magic"}, "magic"),
    ],
)
def test_what_cannot_be_read_is_refused_in_place(
    server: httpx.Client, campaign: str, more: dict[str, str], said: str
) -> None:
    answer = part(server, f"{JOBS}/check", texts(campaign, **more))
    assert 400 <= answer.status_code < 500
    assert said in answer.text
    assert answer.text.startswith('<div class="note bad"')


def test_a_viewer_reads_and_changes_nothing(server: httpx.Client, campaign: str) -> None:
    token = server.post("/v1/tokens", json={"name": "reader", "role": "viewer"}).json()["token"]
    with httpx.Client(base_url=server.base_url, headers={"Authorization": f"Bearer {token}"}, timeout=60) as viewer:
        assert "This needs the role operator" in viewer.get(JOBS).text
        for address in (f"{JOBS}/check", JOBS, "/jobs/job_0000000000000000/cancel"):
            assert viewer.post(address, data=texts(campaign)).status_code == 403


@pytest.mark.parametrize("kind", ["identify", "gap", "evaluate", "plan", "joint_parameters"])
def test_every_option_of_a_kind_has_a_field(server: httpx.Client, campaign: str, kind: str) -> None:
    schemas = server.get("/openapi.json").json()["components"]["schemas"]
    name = "".join(word.title() for word in kind.split("_")) + "Options"
    shown = server.get(f"{JOBS}?kind={kind}&campaigns={campaign}").text
    assert set(re.findall(r'name="option\.(\w+)"', shown)) == set(schemas[name]["properties"])
    assert "null:" not in shown  # a field is left empty
    chosen = shown.partition(f'name="use.{campaign}"')[2].partition("</select>")[0]
    assert '<option value="train" selected>' in chosen


def test_an_identification_shows_the_numbers_of_the_interface(
    server: httpx.Client, done: dict[str, dict[str, Any]]
) -> None:
    job = done["identify"]
    shown = server.get(f"/jobs/{job['id']}").text
    for stage, title in (("nominal", "Before"), ("registration_only", "Registration only"), ("identified", "After")):
        value = job["result"]["metrics"]["validation"][stage]["mean_mm"]
        assert f'data-stage-of="{title}">{mm(value)}<' in shown
    text = html.unescape(shown)
    for direction in job["result"]["null_directions"]:
        assert direction["sentence"] in text
    for parameter in job["result"]["parameters"]:
        carried = parameter["identifiable"] is False and parameter["name"].startswith(("link_m", "load_payload"))
        assert carried or parameter["name"] in text
    bodies = text.partition('aria-label="Table of masses and centres"')[2].partition("</table>")[0].split("<tr>")[2:]
    assert job["result"]["load_model"]
    for number, told in zip(job["result"]["load_model"], bodies, strict=True):
        assert (f">link {number['link']}<" if number["link"] else ">payload<") in told
        assert f"<code>{number['parameter']}</code>" in told
        assert format_with_uncertainty(number["stated"], number["prior_sigma"]) in told
        assert format_with_uncertainty(number["value"], number["sigma"]) in told
        assert f"<td>{'yes' if number['seen'] else 'no'}</td>" in told
    blind = sum(not number["seen"] for number in job["result"]["load_model"])
    assert blind
    assert (
        f"{len(job['result']['load_model'])} masses and centres that were carried beside them {blind} are not" in text
    )
    for row in job["result"]["set_aside"]:
        assert f'<th scope="row">{row["row"]}</th>' in shown
    assert f"/versions/{job['result']['version_id']}" in shown
    assert NASTY not in shown
    assert html.escape(NASTY) in shown


def test_evaluation_and_plan_show_theirs(server: httpx.Client, done: dict[str, dict[str, Any]], campaign: str) -> None:
    shown = server.get(f"/jobs/{done['evaluate']['id']}").text
    assert mm(done["evaluate"]["result"]["metrics"][campaign]["registration_only"]["mean_mm"]) in shown
    assert ">After<" not in shown  # nothing was identified here
    name = server.get(f"/v1/campaigns/{campaign}").json()["name"]
    assert f'Campaign <a href="/campaigns/{campaign}">{name}</a>' in shown  # by name, not by id
    plan = done["plan"]
    assert f"{plan['result']['count']} poses" in server.get(f"/jobs/{plan['id']}").text
    assert (
        f'<td class="number">{plan["result"]["poses"][0]["q1_deg"]:.3f}</td>' in server.get(f"/jobs/{plan['id']}").text
    )
    assert server.get(f"/jobs/{plan['id']}/poses.csv").text == plan["result"]["csv"]
    assert server.get(f"/jobs/{done['evaluate']['id']}/poses.csv").status_code == 400


@pytest.mark.short_path
def test_run_waits_for_the_check_in_the_browser(
    chromium: Browser, server: httpx.Client, done: dict[str, dict[str, Any]], campaign: str
) -> None:
    with opened(chromium, server) as page:
        page.goto(f"{JOBS}?campaigns={campaign}")
        run = page.get_by_role("button", name="Run")
        expect(run).to_be_disabled()
        page.get_by_role("button", name="Check").click()
        page.get_by_text("The check has passed.").wait_for()
        expect(run).to_be_enabled()
        page.locator("#job-name").fill("another")
        expect(run).to_be_disabled()
        page.get_by_text("check them again").wait_for()
        page.get_by_role("button", name="Check").click()
        expect(run).to_be_enabled()
        run.click()
        page.wait_for_url("**/jobs/job_*")
        page.get_by_text("Waiting for a worker").wait_for()
        expect(page.locator("[data-stage]")).to_have_text(re.compile(r"^0 %"))
        expect(page.locator("[data-elapsed]")).to_have_text(re.compile(r"^Waits since \d+:\d\d\.$"))
        page.get_by_role("button", name="Cancel").click()
        page.get_by_text("The job was cancelled").wait_for()


def test_nothing_stands_in_the_way_of_anybody(
    chromium: Browser, server: httpx.Client, done: dict[str, dict[str, Any]], campaign: str
) -> None:
    paths = ["/jobs", f"{JOBS}?campaigns={campaign}", *(f"/jobs/{job['id']}" for job in done.values())]
    with opened(chromium, server, "tablet") as page:
        for path in paths:
            page.goto(path)
            found = Axe().run(page)
            assert found.violations_count == 0, found.generate_report()


def test_an_empty_list_of_held_out_campaigns_holds_nothing_out() -> None:
    asked = parse_new_job("arm", {"kind": "identify", "use.cmp_1": "train"})
    again = NEW_JOB.validate_python({**asked.model_dump(mode="json"), "validation": []})
    assert again.validation is None
