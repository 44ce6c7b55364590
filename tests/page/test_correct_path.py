"""A path corrected on the page: what comes out is what the interface answers, row by row, and refusals are sentences."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser

from .conftest import opened
from .made import Made, made_fixtures

ROWS, REFUSED = 60, 5


there, server = made_fixtures(rows=5)


def path_of(folder: Path) -> Path:
    """A path whose last rows are outside the limit of the last joint, 168 degrees."""
    lines = ["q1_deg,q2_deg,q3_deg,q4_deg,q5_deg"]
    for row in range(ROWS):
        s = math.sin(row / 12)
        last = 172.0 if row >= ROWS - REFUSED else 60 * s
        lines.append(f"{40 * s:.3f},{40 + 15 * s:.3f},{30 - 10 * s:.3f},{20 * s:.3f},{last:.3f}")
    file = folder / "path.csv"
    file.write_text("\n".join(lines) + "\n", encoding="ascii")
    return file


def test_a_robot_without_a_version_says_what_comes_first(there: Made) -> None:
    there.client.post("/v1/robots", json={"name": "bare", "convention": "preset", "preset": "ur10"}).raise_for_status()
    assert "There is no version to correct with" in there.client.get("/robots/bare/correct").text


@pytest.mark.short_path
def test_people_correct_a_path(there: Made, chromium: Browser, tmp_path: Path) -> None:
    file = path_of(tmp_path)
    answer = there.client.post(
        f"/v1/robots/{there.robot}/correct", content=file.read_bytes(), params={"payload_kg": "0.3"},
        headers={"Content-Type": "text/csv"},
    ).raise_for_status()  # fmt: skip
    with opened(chromium, there.client) as page:
        page.goto(f"/robots/{there.robot}/correct")
        page.get_by_role("button", name="Correct it").click()
        page.get_by_text("Choose a path first").wait_for()
        page.locator("#path-file").set_input_files(file)
        page.get_by_label("Mass on the tool").fill("0.3")
        page.get_by_role("button", name="Correct it").click()
        page.get_by_text(f"{ROWS} rows, at most").wait_for()
        counted = page.locator("[data-counts] .badge").all_inner_texts()
        assert f"{REFUSED} joint limit" in counted
        assert page.locator("tr.path-bad").count() == REFUSED
        assert page.locator("[data-rows] tbody tr").first.get_attribute("class") != "path-good"  # those come last
        numbers = page.locator("[data-rows] tr.path-good td.number").all_inner_texts()
        assert numbers
        assert not [one for one in numbers if "e-" in one]  # what rounding leaves is 0
        assert "`" not in page.locator("[data-notes]").inner_text()
        with page.expect_download() as waiting:
            page.get_by_role("link", name="Download the corrected path").click()
        assert waiting.value.suggested_filename == "path-corrected.csv"
        assert Path(waiting.value.path()).read_bytes() == answer.content
        found = Axe().run(page)
        assert found.violations_count == 0, found.generate_report()
        page.set_viewport_size({"width": 390, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        wrong = tmp_path / "wrong.csv"
        wrong.write_text("q1_deg,x_mm\n1,2\n", encoding="ascii")
        page.locator("#path-file").set_input_files(wrong)
        page.get_by_role("button", name="Correct it").click()
        said = page.locator("[data-refused] .note")
        said.wait_for()
        assert "{" not in said.inner_text()
        assert "Column" in said.inner_text()
