"""The checks of a robot on its page and on the fleet's: how it stands, the chart over days, and what was done between them."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser

from kilter_service.contract.today import CheckOfRobot, DriftHistory, DriftMark, ErrorAt, Today
from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.page.shared.control_chart import draw_check_history
from kilter_service.page.words import number
from kilter_service.run.app import create_app
from kilter_service.web.auth.token import admin_token
from tests.core.watch.drifting import some_arm, some_poses
from tests.service.conftest import new_database, ready, served
from tests.service.watched_robot import Watched

from .conftest import opened

CRASHED, MENDED = 4e-3, 12  # rad; the day of the repair


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Iterator[httpx.Client]:
    """One robot as it was, one that crashed after ten checks and was repaired, one that crashed, and one without a version."""
    arm = some_arm(np.random.default_rng(3))
    with new_database() as url:
        settings = Settings(data=tmp_path_factory.mktemp("drift"), database_url=url, host="127.0.0.1", token=None)
        ready(settings, migrated)
        database = Database(settings.database)
        with served(create_app(settings)) as client:
            client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
            for name, days in (("fine", 1), ("repaired", 10), ("crashed", 1)):
                robot = Watched(client, None, arm, name)
                robot.calibrated(database)
                for day in range(days):
                    robot.checked_here(database, arm, 100 + day, day)
                if name != "fine":
                    robot.checked_here(database, arm.after("zero_3", CRASHED), 200, 10)
                if name == "repaired":
                    robot.checked_here(database, arm, 201, MENDED)
            Watched(client, None, arm, "fresh")
            yield client
        database.close()


def words(text: str) -> str:
    return html.unescape(re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", text)))


def section(client: httpx.Client, robot: str) -> str:
    text = client.get(f"/robots/{robot}").raise_for_status().text
    begins = text.index('id="checks"')
    return text[begins : text.index("</section>", begins)]


def test_the_chart_shows_each_check_and_what_was_done_between_them(server: httpx.Client) -> None:
    text = section(server, "repaired")
    said = words(text)
    circles, squares = (len(re.findall(f"<{mark} ", text.split("<details")[0])) for mark in ("circle", "rect"))
    assert (circles, squares) == (11 + 1, 1 + 1)  # with those of the legend
    assert len(re.findall(r'data-goto="\?version=ver_\w+&amp;campaign=cmp_\w+#arm"', text)) == 12
    assert "2026-09-11: moved: zero of joint 3 by 0.2" in said
    assert re.search(r"<title>repaired 2026-09-13 \d\d:\d\d UTC: ver_", text)
    assert re.search(r"<title>activated 20\d\d-", text)
    assert "2026-09-11 07:00 moved: zero of joint 3" in said  # the table
    whole = server.get("/robots/repaired").text
    assert "alarm: all together 1 of 1000 checks" in whole
    assert "12 checks of this version" in words(whole)
    mean = server.get("/v1/robots/repaired/today").json()["history"][10]["mean_mm"]
    assert f">{number(mean)}</td>" in text  # of the check that alarmed


def test_the_page_of_a_check_says_what_it_found_and_what_helps(server: httpx.Client) -> None:
    """It ended in an error of the server: a check makes no version, and has no objections against one."""
    checks = [
        one for one in server.get("/v1/jobs").json()["jobs"] if one["kind"] == "drift" and one["robot"] == "crashed"
    ]
    for one in checks:
        result = server.get(f"/v1/jobs/{one['id']}").json()["result"]
        said = words(server.get(f"/jobs/{one['id']}").raise_for_status().text)
        assert result["sentence"] in said
        assert "All checks" in said
        if result["remedy"]:
            assert result["remedy"].replace("`", "") in said
    assert {bool(server.get(f"/v1/jobs/{one['id']}").json()["result"]["remedy"]) for one in checks} == {True, False}


def test_a_robot_that_was_never_checked_has_no_chart(server: httpx.Client) -> None:
    text = server.get("/robots/fresh").raise_for_status().text
    assert 'class="card over-time"' not in text  # nor an empty card: the first calibration comes first
    assert 'aria-label="First calibration"' in text


def test_the_fleet_has_those_that_moved_first(server: httpx.Client) -> None:
    text = server.get("/").raise_for_status().text
    rows = re.findall(r'<tr data-robot="(\w+)">(.*?)</tr>\s*<tr class="fold">(.*?)</tr>', text, re.DOTALL)
    assert rows[0][0] == "crashed"
    assert "Has moved" in words(rows[0][1])
    assert "Re-zero joint 3" in words(rows[0][1])
    assert re.search(r"Zero of joint 3 by 0\.2\d* deg", words(rows[0][2]))
    assert {name for name, row, _ in rows if "Has moved" in words(row)} == {"crashed"}  # and none that a check clears
    sparks = {name: row.count('class="spark"') for name, row, _ in rows}
    assert sparks == {"crashed": 1, "repaired": 1, "fine": 0, "fresh": 0}


def test_a_dropped_file_of_few_poses_is_proposed_as_a_check(server: httpx.Client) -> None:
    arm = some_arm(np.random.default_rng(3))

    def proposed(robot: str, poses: int) -> tuple[str, str]:
        q = some_poses(poses, np.random.default_rng(5))
        rows = [[*np.degrees(one), *(1e3 * arm.point(one))] for one in q]
        text = "\n".join([",".join([*(f"q{k}_deg" for k in range(1, 7)), "x_mm", "y_mm", "z_mm"]),
                          *(",".join(map(repr, map(float, row))) for row in rows)])  # fmt: skip
        answer = server.post(f"/robots/{robot}/campaigns/new/file", params={"name": "a.csv"}, content=text.encode())
        form = server.get(answer.raise_for_status().json()["address"]).raise_for_status().text
        return re.findall(r'<option value="(train|validation|confirmation)" selected', form)[0], words(form)

    role, said = proposed("fine", 6)
    assert (role, "So few poses beside an active version are a check" in said) == ("validation", True)
    for robot, poses in (("fine", 30), ("fresh", 6)):
        role, said = proposed(robot, poses)
        assert (role, "are a check, as a rule" in said) == ("train", False), robot


def test_a_date_of_years_ago_squeezes_nothing_and_is_said() -> None:
    at = datetime(2026, 11, 1, 12, tzinfo=UTC)

    def drawn(days: list[int]) -> tuple[str, str]:
        history = [
            CheckOfRobot(
                job_id=f"job_{day}", campaign_id="cmp", version_id="ver", at=at + timedelta(days=day), verdict="ok",
                sentence="ok", p_value=0.5, temperature_c=None,
            )
            for day in sorted(days)
        ]  # fmt: skip
        mark = DriftMark(at=at, what="activated", version_id="ver")
        found = DriftHistory(
            robot="arm", state="ok", version_id="ver", sentence="ok", checks=len(days), last=history[-1], age_days=0,
            history=history, marks=[mark], charts=[], run_length=1000, false_alarm=1e-3,
        )  # fmt: skip
        errors = [
            ErrorAt(
                at=one.at, mean_mm=0.1, low_mm=0.08, high_mm=0.12, source="check", job_id=one.job_id, version_id="ver",
                campaign_id="cmp", alarm=False,
            )
            for one in history
        ]  # fmt: skip
        today = Today(
            robot="arm", version_id="ver", newest=None, own=None, changed=False, larger_by_mm=None, compared="",
            not_evaluated=[], missing=None, sentences=[], history=errors,
        )  # fmt: skip
        seen = draw_check_history(found, today)
        assert seen.errors is not None
        return seen.errors.svg(), seen.begins

    svg, begins = drawn([-2496, 1, 2, 3, 9])
    assert begins.startswith("Not drawn: 2020-01-01, long before all others")
    assert "2020" not in svg
    assert (svg.count("2026-11-02: "), svg.count("<title>activated")) == (1, 1)
    svg, begins = drawn([-2496, -2400, 1, 2, 3])
    assert begins.startswith("Not drawn: 2 dates from 2020-01-01 to 2020-04-06")
    for days in ([1, 2, 3, 9], [-50, 1, 2, 3], [-300, -200, -90, 1, 2], [-2496, -2495, -2494, 1]):
        svg, begins = drawn(days)
        assert begins == ""
        assert len(re.findall(r"\d: \d+ µm</title>|\d: 0.100 mm</title>", svg)) == len(days)


def test_the_form_of_a_repair_refuses_what_the_interface_does(server: httpx.Client) -> None:
    def refused(what: str, at: str) -> str:
        answer = server.post("/robots/fresh/repairs", data={"what": what, "at": at}, headers={"HX-Request": "true"})
        assert answer.status_code >= 400, answer.text
        return words(answer.text)

    assert "Say what was done, as: gear of joint 3 replaced" in refused("  ", "")
    assert "is not a date and a time: give it as 2026-11-18T14:30, in UTC, or leave it empty" in refused("gear", "noon")
    tomorrow = datetime.now(UTC) + timedelta(days=1)
    assert "say when it was done, or leave the date out for now" in refused("gear", f"{tomorrow:%Y-%m-%dT%H:%M}")
    assert not [one for one in server.get("/v1/robots/fresh/drift").json()["marks"] if one["what"] == "repair"]


@pytest.mark.parametrize("width", [1440, 390])
def test_a_repair_is_recorded_and_taken_back_on_the_page(chromium: Browser, server: httpx.Client, width: int) -> None:
    before = server.get("/v1/robots/crashed/drift").json()
    with opened(chromium, server) as page:
        page.set_viewport_size({"width": width, "height": 900})
        page.goto("/robots/crashed")
        page.get_by_role("link", name="It was repaired").first.click()  # opens the fold
        form = page.locator("#repairs")
        form.get_by_label("What was done").fill("gear of joint 3 replaced")
        form.get_by_label("When, UTC").fill("2999-01-01T00:00")
        form.get_by_role("button", name="Record it").click()
        form.get_by_text("say when it was done").wait_for()
        form.get_by_label("When, UTC").fill("2026-09-11T14:30")
        with page.expect_navigation():
            form.get_by_role("button", name="Record it").click()
        row = form.get_by_role("row", name="gear of joint 3 replaced")
        row.wait_for()  # the fold is open: nobody has checked since
        assert "2026-09-11 14:30" in row.inner_text()
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        found = Axe().run(page, context="#repairs")
        assert found.violations_count == 0, found.generate_report()
        told = server.get("/v1/robots/crashed/drift").json()
        assert (told["state"], told["checks"]) == ("never", 0)
        assert told["repaired_at"] == "2026-09-11T14:30:00Z"
        page.on("dialog", lambda asked: asked.accept())
        with page.expect_navigation():
            form.get_by_role("button", name="Remove the repair gear of joint 3 replaced").click()
    after = server.get("/v1/robots/crashed/drift").json()
    assert (after["state"], after["marks"]) == ("moved", before["marks"])


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("width", [1440, 390])
def test_the_chart_can_be_read(chromium: Browser, server: httpx.Client, theme: str, width: int) -> None:
    folder = Path(__file__).parents[2] / "build" / "page-screenshots"
    folder.mkdir(parents=True, exist_ok=True)
    with opened(chromium, server) as page:
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=theme)  # type: ignore[arg-type]
        page.goto("/robots/repaired#checks")  # which opens the fold
        checks = page.locator("#checks")
        checks.screenshot(path=folder / f"checks-{width}-{theme}.png")
        assert checks.evaluate("e => e.scrollWidth <= e.clientWidth")
        size = checks.locator("svg text").first.evaluate("e => e.getBoundingClientRect().height")
        assert size >= 9
        cut = checks.locator("svg").evaluate_all(
            "all => all.flatMap(svg => [...svg.querySelectorAll('text')].filter(one => {"
            "  const text = one.getBoundingClientRect(), room = svg.getBoundingClientRect();"
            "  return text.right > room.right + 0.5 || text.left < room.left - 0.5;"
            "}).map(one => one.textContent))"
        )
        assert cut == []
        found = Axe().run(page, context="#checks")
        assert found.violations_count == 0, found.generate_report()
        page.goto("/")
        page.screenshot(path=folder / f"fleet-checks-{width}-{theme}.png", full_page=True)


def test_a_note_is_a_mark_and_changes_no_check(chromium: Browser, server: httpx.Client) -> None:
    before = server.get("/v1/robots/crashed/drift").json()
    with opened(chromium, server) as page:
        page.goto("/robots/crashed")
        page.get_by_text("Repairs and notes").click()
        form = page.locator("#repairs")
        form.get_by_label("What was done").fill("crash into the fixture")
        form.get_by_label("When, UTC").fill("2026-09-10T09:00")
        form.get_by_label("It is").select_option("note")
        with page.expect_navigation():
            form.get_by_role("button", name="Record it").click()
        marks = page.locator("#checks svg title").all_text_contents()
        assert any(one.startswith("note") and one.endswith("crash into the fixture") for one in marks), marks
    told = server.get("/v1/robots/crashed/drift").json()
    (note,) = [one for one in told["marks"] if one["what"] == "note"]
    assert {**told, "marks": before["marks"]} == before  # state, checks and sums are what they were
    server.delete(f"/v1/robots/crashed/repairs/{note['repair_id']}").raise_for_status()


def test_a_note_on_rows_is_shown_with_their_campaign(server: httpx.Client) -> None:
    (campaign, *_) = server.get("/v1/robots/crashed/campaigns").json()["campaigns"]
    asked = {"what": "the target slipped", "kind": "note", "campaign_id": campaign["id"], "rows": "2-3"}
    note = server.post("/v1/robots/crashed/repairs", json=asked).raise_for_status().json()
    assert (note["kind"], note["campaign_id"], note["rows"]) == ("note", campaign["id"], "2-3")
    shown = words(server.get(f"/campaigns/{campaign['id']}").text)
    assert "the target slipped on rows 2-3" in shown
    form = server.get(f"/campaigns/{campaign['id']}/rows", params={"rows": "2-3"}).text
    assert 'name="kind" value="note"' in form
    other = server.post("/v1/robots/fresh/repairs", json=asked)
    assert (other.status_code, other.json()["code"]) == (400, "option_invalid")
    server.delete(f"/v1/robots/crashed/repairs/{note['id']}").raise_for_status()
