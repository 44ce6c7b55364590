"""Fixtures of the page: a server with a database of its own, and Chromium in front of it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Browser, BrowserContext, Page, sync_playwright

from tests.service.conftest import migrated, shared_client, shared_settings

__all__ = ["migrated", "shared_client", "shared_settings"]

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
# Chromium draws WebGL without a graphics card only when it is told to; as root it has no sandbox.
ARGUMENTS = ["--no-sandbox", "--enable-unsafe-swiftshader", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"]
SIZES = {"desktop": {"width": 1366, "height": 850}, "tablet": {"width": 820, "height": 1180}}
HERE = Path(__file__).parent
OpenPage = Callable[..., Page]


@pytest.fixture(scope="module")
def server(shared_client: httpx.Client) -> httpx.Client:
    """The API process, with the admin token in the client's headers."""
    return shared_client


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    """Debian's Chromium. Of the module: while it is open, its event loop is in the way of every other one."""
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed: apt-get install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave what is seen in Chromium to `python -m tools.lab page`, but for a short path at one size."""
    for item in items:
        if item.path.parent != HERE or "chromium" not in getattr(item, "fixturenames", ()):
            continue
        given = item.callspec.params if hasattr(item, "callspec") else {}
        if item.get_closest_marker("short_path") is None or "tablet" in given.values():
            item.add_marker(pytest.mark.slow)


class Complaints:
    """What the browser says against a page: errors of scripts, refusals of the policy, requests that failed."""

    def __init__(self, page: Page) -> None:
        self.found: list[str] = []
        page.on("console", lambda message: self._take(message.type, f"{page.url}: {message.text}"))
        page.on("pageerror", lambda error: self.found.append(str(error)))

    def _take(self, kind: str, text: str) -> None:
        # A refusal is an answer like others; Chromium reports its status as an error of the console.
        if kind == "error" and "Failed to load resource" not in text:
            self.found.append(text)


@contextmanager
def opened(browser: Browser, server: httpx.Client, size: str = "desktop", token: bool = True) -> Iterator[Page]:
    """A page of its own browser context, logged in as admin; it fails where the browser complained of something."""
    context: BrowserContext = browser.new_context(base_url=str(server.base_url), viewport=SIZES[size])  # type: ignore[arg-type]
    page = context.new_page()
    complaints = Complaints(page)
    if token:
        log_in(page, server.headers["authorization"].removeprefix("Bearer "))
    yield page
    context.close()
    assert complaints.found == []


def log_in(page: Page, token: str) -> None:
    """Log in by the form, as people do."""
    page.goto("/login")
    page.get_by_label("Token").fill(token)
    page.get_by_role("button", name="Log in").click()
    page.wait_for_url("**/")


@pytest.fixture(params=sorted(SIZES))
def page(request: pytest.FixtureRequest, chromium: Browser, server: httpx.Client) -> Iterator[Page]:
    """A page, once of a laptop's size and once of a tablet's."""
    with opened(chromium, server, request.param) as page:
        yield page
