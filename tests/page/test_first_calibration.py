"""A new arm is calibrated from nothing by the page alone: a strip says what is missing, and eight clicks are enough."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect

from kilter_core.plan.d_optimal import iso_poses
from kilter_core.twin import thesis_katana
from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.jobs.work import store
from kilter_service.jobs.work.runner import Runner
from kilter_service.run.app import create_app
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import new_database, ready, served

from .conftest import opened

MOST_CLICKS = 8
PRESET = "katana450-chapter5"
Server = tuple[httpx.Client, Database]


@pytest.fixture(scope="module")
def there(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Iterator[Server]:
    """A server without a robot; no job runs by itself."""
    with new_database() as url:
        settings = Settings(data=tmp_path_factory.mktemp("first"), database_url=url, host="127.0.0.1", token=None)
        ready(settings, migrated)
        database = Database(settings.database)
        with served(create_app(settings)) as client:
            client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
            yield client, database
        database.close()


class Person:
    """Clicks, chooses and drops, and counts each of it."""

    def __init__(self, page: Page) -> None:
        self.page, self.count = page, 0

    def press(self, role: str, name: str) -> None:
        self.page.get_by_role(role, name=re.compile(name)).first.click()  # type: ignore[arg-type]
        self.count += 1

    def choose(self, label: str, value: str) -> None:
        self.page.get_by_label(label).select_option(value)
        self.count += 1

    def drop(self, file: Path) -> None:
        self.page.locator("#first-file").set_input_files(file)
        self.count += 1


def measured(file: Path, poses: int, seed: int) -> Path:
    """Write what an instrument measured of an arm with hidden errors, as a table."""
    twin = thesis_katana(PRESET)
    seen = twin.observe(iso_poses(twin.robot, poses, seed), noise_m=1e-5, seed=seed)
    assert seen.position is not None
    with file.open("w", newline="", encoding="utf-8") as out:
        rows = csv.writer(out)
        rows.writerow([*(f"q{joint + 1}_deg" for joint in range(seen.q.shape[1])), "x_mm", "y_mm", "z_mm"])
        rows.writerows(np.hstack([np.degrees(seen.q), 1e3 * seen.position]).round(6).tolist())
    return file


def work(database: Database, kind: str) -> None:
    """Run the job that waits, as a worker does."""
    with database.transaction() as session:
        claim = store.claim(session, "here", [kind])
    assert claim is not None
    Runner(database).run(claim)


def stage(page: Page, name: str) -> None:
    """Wait until this stage is the one that comes next."""
    expect(page.locator('#first [aria-current="step"]')).to_have_text(name)


@pytest.mark.slow
def test_a_new_arm_is_calibrated_by_eight_clicks(chromium: Browser, there: Server, tmp_path: Path) -> None:
    client, database = there
    with opened(chromium, client) as page:
        person = Person(page)
        page.goto("/")
        person.press("link", "^(New robot|Add one)$")
        page.get_by_label("Name").fill("new")
        person.choose("A robot that Kilter knows", PRESET)
        person.press("button", "^Add this robot$")
        page.wait_for_url("**/robots/new")
        stage(page, "Measure")
        person.drop(measured(tmp_path / "monday.csv", 60, 1))
        person.press("button", "^Store, identify and search$")
        page.wait_for_url("**/jobs/job_*")
        found = client.get(f"/v1/jobs/{page.url.rpartition('/')[2]}").json()
        assert (found["kind"], len(found["campaigns"])) == ("gap", 1)
        waiting = client.get("/v1/robots/new/today").json()["standing"]
        assert [step["do"] for step in waiting["steps"]] == ["await_job", "upload"]
        work(database, "gap")
        page.reload()
        person.press("button", "^Activate…$")
        person.press("button", "^Activate (now|anyway)")
        page.wait_for_url("**/robots/new")
        stage(page, "Correct")
        expect(page.locator("#first li.done")).to_have_count(5)
        person.press("link", "^Correct a path$")
        expect(page.get_by_label("The path, a row for each setpoint")).to_be_visible()
        assert person.count <= MOST_CLICKS
    assert client.get("/v1/robots/new").json()["active_version"]


@pytest.mark.short_path
def test_the_strip_says_what_is_missing_and_goes_away(chromium: Browser, there: Server) -> None:
    client, _ = there
    document = {"name": "bare", "convention": "preset", "preset": PRESET}
    client.post("/v1/robots", json=document).raise_for_status()
    with opened(chromium, client) as page:
        for width in (1440, 390):
            page.set_viewport_size({"width": width, "height": 900})
            page.goto("/robots/bare")
            stage(page, "Measure")
            expect(page.locator("#first")).to_contain_text("Nothing was measured yet.")
            assert page.evaluate("document.documentElement.scrollWidth - window.innerWidth") <= 0
            assert Axe().run(page).response["violations"] == []
        page.get_by_role("button", name="Plan the poses").click()
        page.wait_for_url("**/jobs/job_*")
        asked = client.get(f"/v1/jobs/{page.url.rpartition('/')[2]}").json()
        assert (asked["kind"], asked["options"]["purpose"], asked["options"]["within"]) == (
            "plan", "identify", "limits",
        )  # fmt: skip
        client.post(f"/v1/jobs/{asked['id']}/cancel").raise_for_status()
        expect(page.locator("main")).to_contain_text(
            "cancelled"
        )  # it is loaded anew: a browser closed meanwhile may hang


@pytest.mark.short_path
def test_planned_poses_are_stepped_through_and_judged_as_their_rows_arrive(chromium: Browser, there: Server) -> None:
    client, database = there
    client.post("/v1/robots", json={"name": "planned", "convention": "preset", "preset": PRESET}).raise_for_status()
    asked = {"kind": "plan", "robot": "planned", "options": {"purpose": "identify", "within": "limits", "count": 12}}
    job = client.post("/v1/jobs", json=asked).raise_for_status().json()["id"]
    work(database, "plan")
    planned = client.get(f"/v1/jobs/{job}").json()["result"]["poses"]
    twin = thesis_katana(PRESET)
    q = np.radians([[pose[f"q{joint}_deg"] for joint in range(1, 6)] for pose in planned])
    with opened(chromium, client) as page:
        page.goto("/robots/planned")
        stage(page, "Measure")
        page.get_by_role("link", name="Measure 12 planned poses").click()
        place = page.locator("[data-arm][data-ready]")
        place.wait_for()
        before = place.get_attribute("data-tool")
        expect(page.locator("[data-said]")).to_contain_text("Pose 1 of 12, not measured yet")
        page.get_by_role("button", name="Next pose").click()
        expect(page.locator("[data-said]")).to_contain_text("Pose 2 of 12")
        assert place.get_attribute("data-tool") != before
        expect(page.locator("tr[data-current] th")).to_have_text("2")

        first = np.repeat(q[:6], 2, axis=0)
        seen = twin.observe(first, noise_m=1e-5, seed=1)
        assert seen.position is not None
        points = 1e3 * seen.position
        points[3] += (3.0, 0.0, 0.0)  # of the second pose: apart from its repeat
        columns = {f"q{joint + 1}_deg": np.degrees(first[:, joint]).tolist() for joint in range(5)}
        columns |= {f"{axis}_mm": points[:, k].tolist() for k, axis in enumerate("xyz")}
        sent = client.post("/v1/robots/planned/campaigns", json={"name": "monday"}).raise_for_status().json()["id"]
        client.post(f"/v1/campaigns/{sent}/observations", json=columns).raise_for_status()
        expect(page.locator('tr[data-pose="good"]')).to_have_count(5, timeout=15_000)
        expect(page.locator('tr[data-pose="bad"] th')).to_have_text("2")
        expect(page.locator("#poses [role=status]")).to_have_text("6 of 12 have a row, 1 of them wrong.")
        expect(page.locator("[data-said]")).to_contain_text("Pose 7 of 12")  # the one that was waited for has come
        assert Axe().run(page).response["violations"] == []
