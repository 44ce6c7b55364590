"""Every view that a person can open, at two widths, light and dark: named here one by one, so that a new one is looked at."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import httpx
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page

from kilter_service.web.auth.policy import PAGE_RULES

from .conftest import log_in, opened
from .made import Made, made

VIEWS: Mapping[str, str] = {
    "GET /": "/",
    "GET /login": "/login",
    "GET /find": "/find?sought=katana",
    "GET /new-robot": "/new-robot",
    "GET /robots/{robot}": "/robots/{robot}",
    "GET /robots/{robot}/settings": "/robots/{robot}/settings",
    "GET /robots/{robot}/state": "/robots/{robot}/state",
    "GET /robots/{robot}/worst": "/robots/{robot}/worst?version={good}&campaign={campaign}",
    "GET /robots/{robot}/pose": "/robots/{robot}/pose?version={good}&campaign={campaign}&row=2",
    "GET /robots/{robot}/correct": "/robots/{robot}/correct",
    "GET /robots/{robot}/kit": "/robots/{robot}/kit",
    "GET /robots/{robot}/versions": "/robots/{robot}/versions",
    "GET /robots/{robot}/versions/compare": "/robots/{robot}/versions/compare?version={poor}&version={good}",
    "GET /robots/{robot}/rollback": "/robots/{robot}/rollback",
    "GET /versions/{version}": "/versions/{good}",
    "GET /versions/{version}/exports": "/versions/{good}/exports",
    "GET /versions/{version}/contributions": "/versions/{good}/contributions",
    "GET /versions/{version}/by-factor": "/versions/{good}/by-factor?campaign={campaign}",
    "GET /versions/{version}/workspace": "/versions/{good}/workspace",
    "GET /versions/{version}/activation": "/versions/{poor}/activation",
    "GET /versions/{version}/report": "/versions/{good}/report",
    "GET /versions/{a}/compare/{b}": "/versions/{poor}/compare/{good}?campaign={campaign}",
    "GET /robots/{robot}/campaigns": "/robots/{robot}/campaigns",
    "GET /robots/{robot}/campaigns/new": "/robots/{robot}/campaigns/new",
    "GET /campaigns/{campaign}": "/campaigns/{campaign}",
    "GET /campaigns/{campaign}/rows": "/campaigns/{campaign}/rows?rows=1-9",
    "GET /robots/{robot}/stream": "/robots/{robot}/stream",
    "GET /robots/{robot}/bridges": "/robots/{robot}/bridges",
    "GET /robots/{robot}/jobs": "/robots/{robot}/jobs",
    "GET /robots/{robot}/jobs/campaigns": "/robots/{robot}/jobs/campaigns?kind=identify&sought=a",
    "GET /jobs": "/jobs",
    "GET /jobs/{job}": "/jobs/{job}",
    "GET /audit": "/audit",
    "GET /access": "/access",
}
# What is read by programs, and views that take a draft or what a search found: test_drop.py and test_gap.py open these.
OTHERS = {
    "GET /assets/{name}", "GET /robots/{robot}/arm.json", "GET /robots/{robot}/places.json", "GET /robots/{robot}/reach.json",
    "GET /robots/{robot}/meshes/{link}", "GET /robots/{robot}/stream/events", "GET /campaigns/{campaign}/series.json",
    "GET /campaigns/{campaign}/values.json", "GET /campaigns/{campaign}/rows.json", "GET /campaigns/{campaign}/rows.csv",
    "GET /versions/{version}/report.pdf", "GET /jobs/{job}/report.pdf",
    "GET /jobs/{job}/report.html", "GET /jobs/{job}/poses.csv",
    "GET /robots/{robot}/campaigns/new/{draft}", "GET /jobs/{job}/report", "GET /jobs/compare",
    "GET /robots/{robot}/campaigns/new/board.zip", "GET /robots/{robot}/campaigns/new/reading",
}  # fmt: skip
OF_AN_ID = {"GET /versions/{version}", "GET /versions/{version}/report", "GET /campaigns/{campaign}", "GET /jobs/{job}"}
CELLS = r"[...document.querySelectorAll('td')].map(one => one.textContent.trim())"
UNIT_IN_CELL = re.compile(r"-?[\d.]+ ?(mm|µm|deg|°|N m|kg)")
ID = re.compile(r"\b(ver|cmp|job)_[0-9a-f]{16}\b")


@pytest.fixture(scope="module")
def there(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Iterator[Made]:
    with made(tmp_path_factory.mktemp("views"), migrated) as found:
        for version in (found.poor, found.good):
            wish = {"force": True, "reason": "to look at it"}
            found.client.post(f"/v1/versions/{version}/activate", json=wish).raise_for_status()
        yield found


@pytest.fixture(scope="module")
def server(there: Made) -> httpx.Client:
    return there.client


def test_every_view_is_named() -> None:
    assert set(VIEWS) | OTHERS == {route for route in PAGE_RULES if route.startswith("GET ")}
    assert not set(VIEWS) & OTHERS


@pytest.mark.parametrize("width", [1440, 390])
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_a_view_is_whole(there: Made, chromium: Browser, width: int, theme: str) -> None:
    """None stands in anybody's way, scrolls sideways, has a unit in a cell, an id for a name, or a title of its own kind."""
    job = {"kind": "identify", "robot": there.robot, "campaigns": [there.campaign]}
    names = {"robot": there.robot, "good": there.good, "poor": there.poor, "campaign": there.campaign}
    names["job"] = there.client.post("/v1/jobs", json=job).raise_for_status().json()["id"]
    with opened(chromium, there.client) as page:
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=theme)  # type: ignore[arg-type]
        page.goto(f"/robots/{there.robot}/settings")  # tells the server how wide the window is
        wrong = {route: found for route in VIEWS if (found := _wrong(page, route, VIEWS[route].format_map(names)))}
    assert wrong == {}


def _wrong(page: Page, route: str, address: str) -> list[str]:
    answer = page.goto(address)
    page.wait_for_load_state("load")
    page.locator("main").first.wait_for()
    for part in page.locator('[hx-get][hx-trigger="load"]').all():  # what comes by itself
        part.locator(":scope:not(.htmx-request)").wait_for()
    found = [] if answer is not None and answer.status == 200 else [f"answers {answer and answer.status}"]
    found += [f"{one['id']}: {one['nodes'][0]['target']}" for one in Axe().run(page).response["violations"]]
    if page.evaluate("document.documentElement.scrollWidth") > page.evaluate("window.innerWidth"):
        found.append("scrolls sideways")
    found += [f"unit in a cell: {cell}" for cell in page.evaluate(CELLS) if UNIT_IN_CELL.fullmatch(cell)]
    shown = page.locator("body").inner_text()
    found += [f"id for a name: {one[0]}" for one in ID.finditer(shown) if route not in OF_AN_ID]
    if not page.title().endswith("Kilter") or ID.search(page.title()):
        found.append(f"title {page.title()!r}")
    return found


def test_without_javascript_the_numbers_are_there(there: Made, chromium: Browser) -> None:
    context = chromium.new_context(base_url=str(there.client.base_url), java_script_enabled=False)
    page = context.new_page()
    log_in(page, there.client.headers["authorization"].removeprefix("Bearer "))
    for address, said in (
        (f"/robots/{there.robot}", ("20.0 µm", "The picture needs JavaScript")),
        (f"/versions/{there.good}", ("Parameters it knows", "20.0 µm")),
        (f"/campaigns/{there.campaign}", ("60 rows", "What was measured", "The plot needs JavaScript")),
        ("/jobs", ("identification of",)),
    ):
        page.goto(address)
        text = page.locator("main").inner_text()
        assert all(one in text for one in said), address
    page.goto(f"/robots/{there.robot}")
    page.get_by_role("link", name="The worst poses").click()
    assert page.get_by_role("heading", name="Where the robot is worst").count() == 1
    context.close()


@pytest.mark.parametrize("address", ["/robots", "/nothing/here", "/robots/nobody", "/versions/ver_0", "/jobs/job_0"])
def test_an_address_that_there_is_not_is_a_page_with_a_way_out(there: Made, address: str) -> None:
    answer = there.client.get(address, headers={"Accept": "text/html,application/xhtml+xml,*/*;q=0.8"})
    assert answer.status_code in (400, 404, 422)
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    assert re.search(r"<title>[^<]+ · Kilter</title>", answer.text)
    assert 'role="alert"' in answer.text
    assert re.search(r'<a href="/">To the robots</a>', answer.text)
    interface = there.client.get(f"/v1{address}", headers={"Accept": "text/html"})
    assert (interface.status_code == 200) or interface.headers["content-type"] == "application/problem+json"
