"""The parts of the page: one set of colours everywhere, the overview on one screen, and a state of a robot in a word."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

import httpx
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser

from kilter_service.contract.fits import Errors, Parameter, StageErrors
from kilter_service.contract.jobs.kind import JobSummary, Progress
from kilter_service.contract.streams import Bridge
from kilter_service.contract.today import DriftSummary, ErrorsToday, Today
from kilter_service.contract.versions import VersionSummary
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.naming import display_name
from kilter_service.page.figures.plot import MEANINGS
from kilter_service.page.shared.standing import Correcting, Corrector, assess_robot_state
from kilter_service.page.words import format_in_largest_unit, parameter_sigma
from kilter_service.versions.today.standing import Known, assess

from .conftest import opened
from .made import Made, made_fixtures
from .test_robot import arm_of, words

REPOSITORY = Path(__file__).resolve().parents[2]
SOURCES = REPOSITORY / "service" / "kilter_service" / "page" / "sources"
READY = Correcting("ready", "faint", "The corrector runs.")


there, server = made_fixtures()


def test_style_sheet_picture_and_docs_have_the_colours_of_the_figures() -> None:
    style = dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6});", (SOURCES / "page.css").read_text(encoding="utf-8")))
    assert {name: style[name] for name in MEANINGS} == MEANINGS
    rows = re.search(r"ROWS = \{(.*?)\}", (SOURCES / "arm" / "parts.js").read_text(encoding="utf-8"))
    assert rows is not None
    drawn = {name: f"#{value}" for name, value in re.findall(r"(\w+): 0x([0-9a-f]{6})", rows[1])}
    asked = {"fitted": "fitted", "held": "held-out", "aside": "set-aside", "chosen": "chosen", "error": "error"}
    assert drawn == {short: MEANINGS[name] for short, name in asked.items()}
    page = (REPOSITORY / "docs" / "reference" / "page-parts.md").read_text(encoding="utf-8")
    assert dict(re.findall(r"\| `([a-z-]+)` \| (#[0-9a-f]{6}) \|", page)) == MEANINGS


def of_today(source: str = "held_out", changed: bool = False, version: str | None = "ver_1") -> Today:
    errors = StageErrors(n=40, identified=Errors(mean_mm=0.02, rms_mm=0.022))
    newest = ErrorsToday(source=source, job_id="job_1", at=utc_now(), campaigns=[], refit=[], rows="", errors=errors)  # type: ignore[arg-type]
    made = Today(
        robot="arm", version_id=version, newest=newest, own=newest, changed=changed, larger_by_mm=0.5 if changed else None,
        compared="", not_evaluated=[], missing=None, sentences=["No version is active."],
    )  # fmt: skip
    checked = DriftSummary(
        robot="arm", state="never", version_id=version, sentence="", checks=0, last=None, age_days=None
    )
    return made.model_copy(update={"standing": assess(made, checked, Known())})


@pytest.mark.parametrize(
    ("today", "seen", "word"),
    [
        (of_today(), READY, f"As calibrated on {utc_now().day} {utc_now():%B}"),
        (of_today(changed=True), READY, "Has changed"),
        (of_today(version=None), READY, "Not calibrated"),
        (of_today(source="fitted"), READY, "Not known"),
        (of_today(), Correcting("corrector stopped", "bad", "It does not run.", "Not corrected"), "Not corrected"),
    ],
)
def test_the_state_says_what_is_worst(today: Today, seen: Correcting, word: str) -> None:
    assert assess_robot_state(today, seen).word == word


CALIBRATED = f"As calibrated on {utc_now().day} {utc_now():%B}"


def bridge_that_is(state: str, active: str | None) -> Bridge:
    return Bridge(
        kind="rsi", state=state, version_id="ver_1", cycle_ms=4.0, cycles=1, late=0, lost=0, refused=0, offset_deg=0.1,
        largest_offset_deg=0.1, id="run_1", robot="arm", since=utc_now(), heard_at=utc_now(), silent_s=0.0, gone=False,
        other_version=active != "ver_1", sentence="The rsi bridge corrects.",
    )  # type: ignore[arg-type] # fmt: skip


@pytest.mark.parametrize(
    ("state", "active", "word", "tile"),
    [
        ("correcting", None, "By a bridge", "by a bridge"),
        ("ramping in", None, "By a bridge", "by a bridge"),
        ("waiting", None, "Not calibrated", "bridge waiting"),
        ("correcting", "ver_1", CALIBRATED, "by a bridge"),
        ("waiting", "ver_1", CALIBRATED, "bridge waiting"),
        ("correcting", "ver_2", "Other version", "by a bridge"),
        ("ramping in", "ver_2", "Other version", "by a bridge"),
        ("refusing", "ver_1", "Not corrected", "bridge refusing"),
        ("holding back", "ver_1", "Not corrected", "bridge holding back"),
        ("fading out", "ver_1", "Not corrected", "bridge fading out"),
        ("off", "ver_1", "Not corrected", "bridge off"),
    ],
)
def test_state_and_tile_agree_on_a_bridge_that_was_told_its_version(
    state: str, active: str | None, word: str, tile: str
) -> None:
    seen = Corrector("alive", "1 alive", [], {"arm": [bridge_that_is(state, active)]}).describe_correction(
        "arm", active
    )
    found = assess_robot_state(of_today(version=active), seen)
    assert (found.word, seen.word) == (word, tile)
    if word in ("By a bridge", "Other version") or (active and word == "Not corrected"):
        assert (found.sentence, found.look) == (seen.sentence, "warn")


def test_lengths_beside_each_other_have_the_unit_of_the_largest() -> None:
    assert [format_in_largest_unit(one, 1.25) for one in (0.0171, 0.834, 1.25)] == ["0.0171 mm", "0.834 mm", "1.25 mm"]
    assert [format_in_largest_unit(one, 0.05) for one in (0.0171, 0.05)] == ["17.1 µm", "50.0 µm"]


def test_standard_deviation_and_interval_of_a_line_are_of_one_estimate() -> None:
    told = {"name": "a_2", "unit": "mm", "value": 190.0, "sigma": 0.01, "lower": 189.902, "upper": 190.098}
    assert parameter_sigma(Parameter(**told, interval_from="profile")) == pytest.approx(0.05)
    assert parameter_sigma(Parameter(**told, interval_from="sigma")) == 0.01
    assert parameter_sigma(Parameter(name="a_2", unit="mm", value=190.0, sigma=0.01)) == 0.01


def test_the_settings_hold_what_is_rarely_changed(server: httpx.Client, there: Made) -> None:
    text = server.get(f"/robots/{there.robot}/settings").raise_for_status().text
    for part in ('id="goals"', 'id="controller"', 'id="remarks"', 'id="description"', 'id="shapes"'):
        assert part in text
    assert "controller corrects by itself (absolute accuracy, factory calibration)" in text


def test_a_part_that_is_opened_alone_is_a_page(server: httpx.Client, there: Made) -> None:
    asked = {"version": there.good, "campaign": there.campaign}
    alone = (f"/robots/{there.robot}/worst", f"/versions/{there.good}/exports", f"/versions/{there.good}/contributions")
    for place in alone:
        alone_text = server.get(place, params=asked).raise_for_status().text
        assert ("<html" in alone_text, alone_text.count("<h1>")) == (True, 1), place
        assert "<html" not in server.get(place, params=asked, headers={"HX-Request": "true"}).text, place


def test_what_has_no_name_is_called_by_what_it_is_and_when_it_was_made(there: Made) -> None:
    at = datetime(2026, 11, 2, 14, 5, 9, tzinfo=UTC)
    version = there.client.get(f"/v1/robots/{there.robot}/versions").json()["versions"][0]
    unnamed = [
        VersionSummary.model_validate({**version, "name": "", "created_at": at.isoformat()}),
        JobSummary(
            id="job_1", kind="gap", robot="arm", state="queued", progress=Progress(fraction=0.0, stage=""), error=None,
            created_at=at, started_at=None, finished_at=None,
        ),
    ]  # fmt: skip
    numbered = f"{there.robot} v{version['number']}"
    assert [display_name(one) for one in unnamed] == [numbered, "gap search of arm, 2026-11-02 14:05:09"]
    assert display_name(unnamed[0].model_copy(update={"name": "spring"})) == "spring"


def test_a_row_of_jobs_and_of_versions_needs_no_id(there: Made) -> None:
    client = there.client
    client.patch(f"/v1/versions/{there.good}", json={"name": ""}).raise_for_status()
    try:
        numbered = f"{there.robot} v{client.get(f'/v1/versions/{there.good}').json()['number']}"
        compared = f"/versions/{there.poor}/compare/{there.good}"
        for view in (f"/robots/{there.robot}/versions", compared, f"/robots/{there.robot}"):
            assert numbered in words(client.get(view).raise_for_status().text), view
        done = words(client.get("/audit").raise_for_status().text)
        assert f"activated version {numbered} of {there.robot}" in done
    finally:
        client.patch(f"/v1/versions/{there.good}", json={"name": "version 2"}).raise_for_status()
    jobs = words(client.get("/jobs").text)
    assert "job_0000" not in jobs
    assert "identification of " in jobs


@pytest.mark.short_path
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_overview_is_one_screen(there: Made, chromium: Browser, theme: str) -> None:
    with opened(chromium, there.client) as page:
        page.set_viewport_size({"width": 1440, "height": 900})
        page.emulate_media(color_scheme=theme)  # type: ignore[arg-type]
        page.goto(f"/robots/{there.robot}")
        page.locator("[data-arm][data-ready]").wait_for()
        assert page.locator("main").evaluate("e => e.getBoundingClientRect().bottom") <= 900
        assert page.locator(".verdict .huge").inner_text() == "20.0 µm"
        assert page.locator("svg.budget rect").count() >= 2
        assert page.locator("table.six tr").count() == 6
        found = Axe().run(page)
        assert found.violations_count == 0, found.generate_report()


def test_nothing_scrolls_sideways_on_a_telephone(there: Made, chromium: Browser) -> None:
    with opened(chromium, there.client) as page:
        page.set_viewport_size({"width": 390, "height": 800})
        for view in ("", "/settings"):
            page.goto(f"/robots/{there.robot}{view}")
            page.wait_for_load_state()
            assert page.evaluate("document.documentElement.scrollWidth") <= 390
        arm_of(page, there.robot)
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
