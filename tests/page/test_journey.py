"""The whole way on a real `kilterd serve`, at desktop and tablet size; the pictures stay in build/page-screenshots.

The part that is joined up so far: log in, a robot that is added over HTTP, a version, the live stream with a real
controller, and what goes wrong on the way. The views of campaigns, jobs and versions come in between as they are merged.
"""

from __future__ import annotations

import json
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Browser, Page, expect

from tests.page.conftest import opened
from tests.page.controlling import Controller
from tests.service.conftest import wait_for
from tests.service.test_serve import children
from tools.page_lab import Lab, lab

pytestmark = pytest.mark.slow
PICTURES = Path(__file__).parents[2] / "build" / "page-screenshots"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """All processes, and a robot with an identified and active version."""
    with lab(tmp_path_factory.mktemp("journey")) as made:
        yield made


@pytest.fixture(scope="module")
def client(whole: Lab) -> Iterator[httpx.Client]:
    headers = {"Authorization": f"Bearer {whole.token}"}
    with httpx.Client(base_url=whole.server.url, headers=headers, timeout=30) as client:
        yield client


def keep(page: Page, name: str, size: str) -> None:
    """Keep a picture of the whole page."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=PICTURES / f"{name}-{size}.png", full_page=True)


@pytest.mark.parametrize("size", ["desktop", "tablet"])
def test_from_the_login_to_the_live_stream(chromium: Browser, whole: Lab, client: httpx.Client, size: str) -> None:
    with opened(chromium, client, size) as page:
        expect(page.get_by_role("link", name=whole.robot)).to_be_visible()
        keep(page, "fleet", size)
        page.goto(f"/robots/{whole.robot}/stream")
        expect(page.locator('[data-live="corrector"]')).to_contain_text("answers; it started")
        expect(page.locator('[data-live="active"]')).to_contain_text(whole.version)
        with Controller(whole.server.data, whole.robot, size) as controller:
            section = page.locator(f'.stream[data-name="{size}"]')
            expect(section.locator('[data-field="condition"]')).to_have_text("corrected")
            expect(section.locator('[data-field="tool"]')).to_have_text(re.compile(r"\d (mm|µm)"), timeout=15_000)
            page.wait_for_timeout(4000)
            keep(page, "stream", size)
            controller.outside = True
            wait_for(lambda: controller.last is not None and controller.last.source == "bypass")
            expect(page.locator('[data-live="bypass"]')).to_contain_text("JOINT_LIMIT")
            keep(page, "stream-bypass", size)
            controller.outside = False
            expect(page.locator('[data-live="bypass"]')).to_be_hidden(timeout=15_000)
        expect(section.locator('[data-field="condition"]')).to_have_text("no setpoints", timeout=15_000)


def test_a_robot_that_does_not_exist_and_one_that_never_moved(
    chromium: Browser, whole: Lab, client: httpx.Client
) -> None:
    document = {"name": "still", "convention": "preset", "preset": "katana450-chapter5"}
    client.post("/v1/robots", json=document).raise_for_status()
    with opened(chromium, client) as page:
        answer = page.goto("/robots/nobody/stream")
        assert answer is not None
        assert answer.status == 404
        expect(page.get_by_role("alert")).to_contain_text("nobody")
        page.goto("/robots/still/stream")
        expect(page.locator('[data-live="none"]')).to_contain_text("No stream has run")
        expect(page.locator('[data-live="active"]')).to_contain_text("every setpoint is refused")
        keep(page, "stream-none", "desktop")


def test_the_page_comes_back_when_the_server_does(chromium: Browser, whole: Lab, client: httpx.Client) -> None:
    supervisor = json.loads((whole.server.data / "server.json").read_text())["pid"]

    def updates(page: Page) -> int:
        return int(page.locator("[data-stream]").get_attribute("data-updates") or 0)

    with opened(chromium, client) as page, Controller(whole.server.data, whole.robot, "after"):
        page.goto(f"/robots/{whole.robot}/stream")
        condition = page.locator('.stream[data-name="after"] [data-field="condition"]')
        expect(condition).to_have_text("corrected", timeout=15_000)
        os.kill(children(supervisor)["api"], signal.SIGKILL)
        page.wait_for_timeout(1000)
        before = updates(page)
        wait_for(lambda: updates(page) > before + 10, 60.0)
        expect(page.locator('[data-live="stale"]')).to_be_hidden()
        expect(condition).to_have_text("corrected")
