"""The fleet: what each card says, and in which order."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser

from kilter_service.contract.fits import Errors
from kilter_service.health import store as health
from kilter_service.page.shared.accuracy import interval

from .conftest import opened
from .made import Made, made

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


def cards(client: httpx.Client) -> list[str]:
    text = client.get("/").text
    return [re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", part)) for part in text.split("<article")[1:]]


def beat(there: Made, version: str | None, streams: bool = True) -> None:
    said = [{"robot": there.robot, "stream": "line-1", "version_id": version}] if streams else []
    with there.database.transaction() as session:
        health.beat(session, "corrector", "kilter", 1, {"streams": said})


def test_the_worst_robot_is_first_and_retired_ones_are_hidden(there: Made) -> None:
    fresh, katana = cards(there.client)
    assert "a-fresh-one" in fresh
    assert "not calibrated" in fresh
    assert "add measurements" in fresh
    assert "20.0 µm mean error on held-out poses" in katana
    assert "95 % of 40 points are within 40.0 µm" in katana
    assert "Active version version 2" in katana
    assert "Open jobs none" in katana


def test_open_jobs_are_counted(there: Made) -> None:
    body = {"kind": "identify", "robot": there.robot, "campaigns": [there.campaign]}
    job = there.client.post("/v1/jobs", json=body).raise_for_status().json()["id"]
    assert "Open jobs 1" in cards(there.client)[1]
    there.client.post(f"/v1/jobs/{job}/cancel").raise_for_status()
    assert "Open jobs none" in cards(there.client)[1]


def test_the_state_of_the_corrector_is_that_of_this_robot(there: Made) -> None:
    assert "corrector stopped" in cards(there.client)[1]
    beat(there, there.good)
    fresh, katana = cards(there.client)
    assert "bypassed The corrector passes setpoints on as they are." in fresh
    assert "Stream line-1 is corrected with the active version" in katana
    beat(there, there.poor)
    assert f"Stream line-1 last corrected with {there.poor}, not the active one" in cards(there.client)[1]
    beat(there, None, streams=False)
    assert "No controller has sent it setpoints of this robot" in cards(there.client)[1]


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
