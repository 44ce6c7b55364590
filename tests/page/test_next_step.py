"""What comes next is a button: from an alarm to an arm that is corrected again takes two clicks."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect

from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.jobs.work import store
from kilter_service.jobs.work.runner import Runner
from kilter_service.run.app import create_app
from kilter_service.web.auth.token import admin_token
from tests.core.watch.drifting import some_arm
from tests.service import watched_robot
from tests.service.conftest import new_database, ready, served
from tests.service.watched_robot import Watched

from .conftest import opened

ROBOTS = {"hit": 3, "zeroed": 4, "well": 5}  # and the seeds of their arms


@pytest.fixture(scope="module")
def there(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Iterator[tuple[httpx.Client, Database]]:
    """A robot that moved, one that has a re-zeroed version, too, and one that is as it was; no job runs by itself."""
    with new_database() as url, pytest.MonkeyPatch.context() as patch:
        settings = Settings(data=tmp_path_factory.mktemp("next"), database_url=url, host="127.0.0.1", token=None)
        ready(settings, migrated)
        database = Database(settings.database)
        with served(create_app(settings)) as client:
            client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
            patch.setattr(watched_robot, "DAY", datetime.now(UTC) - timedelta(days=20))
            for name, seed in ROBOTS.items():
                arm = some_arm(np.random.default_rng(seed))
                robot = Watched(client, None, arm, name)
                robot.calibrated(database, 0.25)
                robot.checked_here(database, arm, 100, 5)
                if name != "well":
                    robot.checked_here(database, arm.after("zero_3", 4e-3), 200, 12)
                if name == "zeroed":
                    last = robot.history()["last"]["campaign_id"]
                    robot.done_here(database, "rezero", [last], causes=["zero_3"])
            yield client, database
        database.close()


class Clicks:
    """Clicks, and counts them."""

    def __init__(self, page: Page) -> None:
        self.page, self.count = page, 0

    def button(self, name: str) -> None:
        self.page.get_by_role("button", name=re.compile(name)).first.click()
        self.count += 1


def work(database: Database) -> None:
    """Run the job that waits, as a worker does."""
    with database.transaction() as session:
        claim = store.claim(session, "here", ["rezero"])
    assert claim is not None
    Runner(database).run(claim)


def active(client: httpx.Client, robot: str) -> str:
    return str(client.get(f"/v1/robots/{robot}").raise_for_status().json()["active_version"])


@pytest.mark.short_path
def test_an_alarm_is_corrected_by_two_clicks(chromium: Browser, there: tuple[httpx.Client, Database]) -> None:
    client, database = there
    before = active(client, "hit")
    with opened(chromium, client) as page:
        page.goto("/robots/hit")
        expect(page.locator(".state-word").first).to_have_text("Has moved")
        clicks = Clicks(page)
        clicks.button("^Re-zero joint 3$")
        page.wait_for_url("**/jobs/job_*")
        work(database)
        clicks.button("^Activate now$")
        page.wait_for_url("**/robots/hit")
        assert clicks.count == 2
    made = active(client, "hit")
    assert made != before
    parent = client.get(f"/v1/versions/{made}").json()["parent_id"]
    assert parent == before


@pytest.mark.short_path
def test_a_version_that_stands_ready_is_activated_from_the_fleet(
    chromium: Browser, there: tuple[httpx.Client, Database]
) -> None:
    client, _ = there
    before = active(client, "zeroed")
    with opened(chromium, client) as page:
        page.goto("/")
        row = page.locator('tr[data-robot="zeroed"]')
        expect(row).to_contain_text("Has moved")
        row.get_by_role("button", name="Activate re-zeroed v2").click()
        page.get_by_role("button", name="Activate now").click()
        page.wait_for_url("**/robots/zeroed")
    assert active(client, "zeroed") != before


@pytest.mark.parametrize("width", [1440, 390])
def test_a_check_is_a_picture_with_its_rivals(
    chromium: Browser, there: tuple[httpx.Client, Database], width: int
) -> None:
    client, _ = there
    check = next(
        one["id"]
        for one in client.get("/v1/jobs").json()["jobs"]
        if one["kind"] == "drift" and one["robot"] == "zeroed"
    )
    result = client.get(f"/v1/jobs/{check}").json()["result"]
    before, after = (np.linalg.norm([one[name] for one in result["rows"]], axis=1) for name in ("error_mm", "after_mm"))
    assert after.max() < 0.3 < before.mean()  # noise is 0.05 mm an axis
    with opened(chromium, client) as page:
        page.set_viewport_size({"width": width, "height": 900})
        page.goto(f"/jobs/{check}")
        assert page.locator("svg.space .arrow.bad").count() == len(result["rows"]) + 1  # and its key
        first = page.locator(".rivals tbody tr").first
        expect(first).to_contain_text("zero of joint 3")
        expect(first).to_contain_text("100 %")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert Axe().run(page).violations_count == 0
        if width == 1440:
            assert page.evaluate("document.documentElement.scrollHeight") <= 900
            assert page.locator("figure svg").count() == 2
            page.goto("/robots/zeroed")
            page.locator("[data-arm][data-ready]").wait_for()
            assert page.evaluate("document.documentElement.scrollHeight") <= 900


def test_what_does_not_come_next_is_not_queued(there: tuple[httpx.Client, Database]) -> None:
    client, _ = there
    answer = client.post("/robots/well/steps", data={"do": "rezero", "campaign": "cmp_0"})
    assert answer.status_code == 400
    assert "is not what comes next for well any more" in answer.text


def test_a_plan_of_a_check_is_queued_whole(there: tuple[httpx.Client, Database]) -> None:
    client, _ = there
    answer = client.post("/robots/well/steps", data={"do": "plan_check"}, follow_redirects=False)
    assert answer.status_code == 303
    job = client.get(f"/v1{answer.headers['location']}").json()
    assert (job["kind"], job["options"]["purpose"], job["options"]["version"]) == (
        "plan",
        "check",
        active(client, "well"),
    )
    client.post(f"/v1/jobs/{job['id']}/cancel").raise_for_status()
