"""The palette finds robots, their views, versions, campaigns and jobs by a few letters, by keyboard alone."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, expect

from .conftest import opened
from .made import Made, made


@pytest.fixture(scope="module")
def there(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Iterator[Made]:
    with made(tmp_path_factory.mktemp("find"), migrated, rows=5) as found:
        found.client.post("/v1/robots", json={"name": "far-arm", "convention": "preset", "preset": "ur5e"})
        yield found


@pytest.fixture(scope="module")
def server(there: Made) -> httpx.Client:
    return there.client


def found(client: httpx.Client, sought: str, robot: str = "") -> list[str]:
    text = client.get("/find", params={"sought": sought, "robot": robot}, headers={"HX-Request": "true"}).text
    return re.findall(r'<a href="([^"]+)">', text)


def test_every_word_must_be_there(there: Made) -> None:
    assert found(there.client, "far")[0] == "/robots/far-arm"
    assert found(there.client, "katana version 2") == [f"/versions/{there.good}"]
    assert found(there.client, "KATANA stream") == [f"/robots/{there.robot}/stream"]
    assert f"/campaigns/{there.campaign}" in found(there.client, "seed 3", there.robot)
    assert found(there.client, "nowhere") == []
    assert "/robots/far-arm" not in found(there.client, "katana")


@pytest.mark.short_path
@pytest.mark.parametrize("width", [1440, 390])
def test_the_keyboard_goes_there(there: Made, chromium: Browser, width: int) -> None:
    with opened(chromium, there.client) as page:
        page.set_viewport_size({"width": width, "height": 900})
        page.goto(f"/robots/{there.robot}/settings")
        page.locator("textarea").first.press("k")  # typed, not asked for
        assert page.get_by_role("dialog", name="Find").count() == 0
        page.locator("h1").click()
        page.keyboard.press("k")
        field = page.get_by_role("dialog", name="Find").get_by_role("searchbox")
        expect(field).to_be_focused()
        field.fill("version 1")
        expect(page.locator("#found a")).to_have_count(1)
        assert Axe().run(page).violations_count == 0
        page.keyboard.press("Enter")
        page.wait_for_url(f"**/versions/{there.poor}")
        page.keyboard.press("k")
        page.keyboard.type("far")
        expect(page.locator("#found a").first).to_have_text("far-arm")
        page.keyboard.press("ArrowDown")
        page.keyboard.press("Enter")
        page.wait_for_url("**/robots/far-arm")
