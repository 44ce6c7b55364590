"""The fleet: what each card says, and in which order."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser
from sqlalchemy import select

from kilter_core.twin import thesis_katana
from kilter_service.contract.fits import Errors
from kilter_service.contract.wording import interval
from kilter_service.ground.db.tables import JobRow, RobotRow
from kilter_service.versions import store
from kilter_service.versions.store import NewVersion
from kilter_service.web import store as health

from .conftest import opened
from .made import Made, made

COARSE = "coarse-arm"
PRESET = {"convention": "preset", "preset": "katana450-chapter5"}


@pytest.fixture(scope="module")
def there(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Iterator[Made]:
    with made(tmp_path_factory.mktemp("fleet"), migrated, rows=5) as found:
        for name in ("a-fresh-one", "z-retired"):
            found.client.post("/v1/robots", json={"name": name, **PRESET}).raise_for_status()
        found.client.post("/v1/robots/z-retired/retire").raise_for_status()
        found.client.post(f"/v1/versions/{found.good}/activate").raise_for_status()
        yield found


@pytest.fixture(scope="module")
def server(there: Made) -> httpx.Client:
    return there.client


def rows(client: httpx.Client) -> dict[str, str]:
    """What people read of each row and its fold, by robot."""
    found = re.findall(r'<tr data-robot="([^"]+)">(.*?</tr>.*?)</tr>', client.get("/").text, re.DOTALL)
    return {name: re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", part)) for name, part in found}


def calibrated(there: Made, robot: str, mean_mm: float) -> None:
    """Store and activate a version of a robot whose held-out errors are these."""
    errors = {"mean_mm": mean_mm, "rms_mm": 1.1 * mean_mm, "p95_mm": 2 * mean_mm, "max_mm": 3 * mean_mm}
    report: dict[str, Any] = {"parameters": [], "metrics": {"validation": {"n": 40, "identified": errors}}}
    covariance = {"names": [], "matrix": [], "units": "SI", "inadequacy_m": 1e-5, "noise_m": 1e-5}
    limits = {"max_joint_deg": 3.0, "max_position_mm": 20.0}
    new = NewVersion(thesis_katana().truth.to_document(), report, covariance, [], limits, None, "test", robot)
    with there.database.transaction() as session:
        key = session.execute(select(RobotRow.id).where(RobotRow.name == robot)).scalar_one()
        job = f"job_{robot:0>16}"
        asked = {"kind": "identify", "robot": robot, "campaigns": [], "validation": None, "options": {}}
        session.add(JobRow(id=job, kind="identify", robot_id=key, request=asked, state="succeeded"))
        session.flush()
        version = store.add(session, key, job, new)
    there.client.post(f"/v1/versions/{version}/activate", json={"force": True, "reason": "test"}).raise_for_status()


def beat(there: Made, version: str | None, streams: bool = True) -> None:
    said = (
        [{"robot": there.robot, "stream": "line-1", "version_id": version, "at_ns": time.time_ns()}] if streams else []
    )
    with there.database.transaction() as session:
        health.beat(session, "corrector", "kilter", 1, {"streams": said})


def test_the_worst_robot_is_first_and_retired_ones_are_hidden(there: Made) -> None:
    beat(there, there.good)
    found = rows(there.client)
    assert list(found) == ["a-fresh-one", there.robot]  # of those that are not known
    assert "Not calibrated" in found["a-fresh-one"]
    assert "Add measurements" in found["a-fresh-one"]
    katana = found[there.robot]
    assert " 20.0 " in katana
    assert "Mean error 20.0 µm" in katana
    assert "v2" in katana or "version 2" in katana


def test_open_jobs_are_counted(there: Made) -> None:
    body = {"kind": "identify", "robot": there.robot, "campaigns": [there.campaign]}
    job = there.client.post("/v1/jobs", json=body).raise_for_status().json()["id"]
    assert "1 open job" in rows(there.client)[there.robot]
    there.client.post(f"/v1/jobs/{job}/cancel").raise_for_status()
    assert "open job" not in rows(there.client)[there.robot]


def test_the_state_of_the_corrector_is_that_of_this_robot(there: Made) -> None:
    beat(there, there.good)
    found = rows(there.client)
    assert "No version is active: every setpoint is refused, and nothing is corrected." in found["a-fresh-one"]
    assert "Stream line-1 is corrected with the active version" in found[there.robot]
    beat(there, there.poor)
    assert f"Stream line-1 last corrected with {there.poor}, not the active one" in rows(there.client)[there.robot]
    beat(there, None, streams=False)
    assert "No controller has sent it setpoints of this robot" in rows(there.client)[there.robot]


def test_robots_are_compared_in_one_unit_that_of_the_largest(there: Made) -> None:
    small, large = COARSE.replace("coarse", "fine"), COARSE
    for name, mean in ((small, 0.02), (large, 3.0)):
        there.client.post("/v1/robots", json={"name": name, **PRESET}).raise_for_status()
        calibrated(there, name, mean)
    try:
        found = rows(there.client)
        assert " 3.00 " in found[large]
        assert " 0.0200 " in found[small]
        assert "Error, mm" in there.client.get("/").text
        # Alone, the small one has the unit of its own numbers, in its head and in the sentence of the answer.
        assert "20.0 µm" in there.client.get(f"/robots/{small}").text
        said = there.client.get(f"/v1/robots/{small}/today").json()["sentences"][0]
        assert said.startswith("Mean error 20.0 µm ")
    finally:
        for name in (small, large):
            there.client.post(f"/v1/robots/{name}/retire").raise_for_status()


def test_four_counts_filter_the_rows(there: Made) -> None:
    there.client.patch(f"/v1/robots/{there.robot}", json={"tolerance_mm": 0.001}).raise_for_status()
    try:
        text = there.client.get("/").text
        counts = {
            look: int(many) for look, many in re.findall(r'class="(\w+)" href="/\?state=\w+"[^>]*><strong>(\d+)', text)
        }
        assert counts == {"bad": 1, "warn": 0, "faint": 1, "good": 0}
        assert re.findall(r'<tr data-robot="([^"]+)">', there.client.get("/?state=bad").text) == [there.robot]
        assert 'class="tolerance"' in text  # on the axis that all share
    finally:
        there.client.patch(f"/v1/robots/{there.robot}", json={"tolerance_mm": None}).raise_for_status()


@pytest.mark.short_path
@pytest.mark.parametrize("width", [1440, 390])
def test_twelve_robots_are_one_screen(there: Made, chromium: Browser, width: int) -> None:
    more = [f"cell-{width}-{k}-with-a-name-that-is-rather-long-for-a-table" for k in range(10)]
    for name in more:
        there.client.post("/v1/robots", json={"name": name, **PRESET}).raise_for_status()
    try:
        with opened(chromium, there.client) as page:
            page.set_viewport_size({"width": width, "height": 900})
            page.goto("/")
            assert page.locator("tr[data-robot]").count() == 12
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            if width == 1440:
                assert page.locator("main").evaluate("e => e.getBoundingClientRect().bottom") <= 900
                heights = page.locator("tr[data-robot]").evaluate_all("all => all.map(e => e.offsetHeight)")
                assert max(heights) <= 46
                assert len(page.locator("main").inner_text().split()) <= 250
            page.locator("tr[data-robot] summary").first.click()
            page.locator("tr.fold").first.wait_for(state="visible")
            assert Axe().run(page).violations_count == 0
    finally:
        for name in more:
            there.client.post(f"/v1/robots/{name}/retire").raise_for_status()


def test_the_interval_of_a_mean_error() -> None:
    low, high = interval(Errors(mean_mm=3.0, rms_mm=5.0), 17) or (0.0, 0.0)
    assert (high - low) / 2 == pytest.approx(1.96 * 4.0 / 4.0)  # deviation 4 by the n-th part: 4 √(17/16) / √17
    assert (high + low) / 2 == pytest.approx(3.0)
    assert interval(Errors(mean_mm=3.0), 17) is None
    assert interval(Errors(mean_mm=3.0, rms_mm=5.0), 1) is None


def test_nothing_stands_in_the_way_of_anybody(there: Made, chromium: Browser) -> None:
    with opened(chromium, there.client, "tablet") as page:
        found = Axe().run(page)
        assert found.violations_count == 0, found.generate_report()
