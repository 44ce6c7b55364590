"""A server that is lost, and a job that ends while nobody looks: every view says so, in words."""

from __future__ import annotations

import re
from contextlib import closing

import pytest
from playwright.sync_api import Browser, Route, expect

from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import JobRow

from .conftest import log_in, opened
from .made import Made, made_fixtures

there, server = made_fixtures(rows=5)


@pytest.mark.short_path
def test_a_lost_server_says_so_and_comes_back(there: Made, chromium: Browser) -> None:
    with opened(chromium, there.client) as page:
        page.goto(f"/robots/{there.robot}/settings")
        page.context.set_offline(True)
        banner = page.locator("#lost")
        expect(banner).to_contain_text("The server does not answer since")
        expect(banner.get_by_role("button")).to_be_hidden()  # there is nothing to load yet
        page.context.set_offline(False)
        expect(banner).to_contain_text("The server answers again", timeout=15_000)
        banner.get_by_role("button", name="Load it anew").click()
        expect(banner).to_be_hidden()


def test_a_part_that_does_not_come_is_a_sentence_with_a_way_out(there: Made, chromium: Browser) -> None:
    context = chromium.new_context(base_url=str(there.client.base_url))  # htmx complains of what is tested here
    with closing(context):
        page = context.new_page()
        log_in(page, there.client.headers["authorization"].removeprefix("Bearer "))
        page.route("**/exports", lambda route: route.abort())
        page.goto(f"/versions/{there.good}")
        tile = page.locator("section").filter(has=page.get_by_role("heading", name="Files for other programs"))
        expect(tile).to_contain_text("This part could not be loaded")
        page.unroute("**/exports")
        tile.get_by_role("button", name="Ask again").click()
        expect(tile).to_contain_text("Kilter's own document")

        def refused(route: Route) -> None:
            body = '{"title": "Busy", "status": 503, "code": "busy", "detail": "The server is busy: try again."}'
            route.fulfill(status=503, content_type="application/problem+json", body=body)

        page.route("**/exports", refused)
        page.reload()
        expect(tile.get_by_role("alert")).to_contain_text("The server is busy: try again.")


REFUSED = {
    "the HTTP interface": (503, "application/problem+json", '{"code": "busy", "detail": "The server is busy: try again."}'),
    "the page": (404, "text/html", '<div class="note bad" role="alert" data-code="gone">Gone. It is gone.</div>'),
    "a proxy": (502, "text/html", "<html><body><h1>Bad gateway</h1></body></html>"),
    "a JSON of a proxy": (500, "application/json", "{"),
}  # fmt: skip
SAID = {
    "the HTTP interface": "The server is busy: try again.", "the page": "Gone. It is gone.",
    "a proxy": "The server refused this (502).", "a JSON of a proxy": "The server refused this (500).",
}  # fmt: skip


@pytest.mark.parametrize("by", sorted(REFUSED))
def test_every_part_that_is_refused_is_a_sentence_and_can_be_asked_again(
    there: Made, chromium: Browser, by: str
) -> None:
    """Each part that loads by itself, of each view that has some, and a list that is searched."""
    status, kind, body = REFUSED[by]
    views = (f"/robots/{there.robot}", f"/robots/{there.robot}/settings", f"/versions/{there.good}")
    with closing(chromium.new_context(base_url=str(there.client.base_url))) as context:
        page = context.new_page()
        log_in(page, there.client.headers["authorization"].removeprefix("Bearer "))

        def refuse(route: Route) -> None:
            if route.request.headers.get("hx-request"):
                route.fulfill(status=status, content_type=kind, body=body)
            else:
                route.continue_()

        seen = 0
        for view in views:
            page.route("**/*", refuse)
            page.goto(view)
            parts = page.locator('[hx-get][hx-trigger="load"], [hx-get][hx-trigger="revealed"]')
            for number in range(parts.count()):
                part = parts.nth(number)
                part.scroll_into_view_if_needed()
                expect(part.get_by_role("alert")).to_contain_text(SAID[by])
                expect(part).not_to_contain_text("{")
            page.unroute("**/*", refuse)
            again = page.get_by_role("button", name="Ask again")
            assert again.count() == (parts.count() if status >= 500 else 0)  # what is gone stays so
            for number in range(parts.count() if status >= 500 else 0):
                parts.nth(number).get_by_role("button", name="Ask again").click()
                expect(parts.nth(number)).not_to_contain_text(SAID[by], timeout=30_000)
            seen += parts.count()
        assert seen >= 6
        page.goto("/jobs")
        page.route("**/*", refuse)
        page.get_by_label("Find a job").press_sequentially("no such job")
        expect(page.locator("#list").get_by_role("alert")).to_contain_text(SAID[by])
        page.unroute("**/*", refuse)
        if status >= 500:
            page.locator("#list").get_by_role("button", name="Ask again").click()
        else:
            page.get_by_label("Find a job").press_sequentially("s")
        expect(page.locator("#list")).to_contain_text("None of")
        assert page.locator("#list #list, header.top").count() == 1  # the list alone, not a page within the page


def test_the_tab_of_a_job_says_that_it_is_over(there: Made, chromium: Browser) -> None:
    job = there.client.post(
        "/v1/jobs", json={"kind": "identify", "robot": there.robot, "campaigns": [there.campaign]}
    ).raise_for_status().json()["id"]  # fmt: skip
    with opened(chromium, there.client) as page:
        page.context.grant_permissions(["notifications"])
        page.add_init_script("window.told = []; window.Notification = class { static permission = 'granted'; "
                             "static requestPermission = async () => 'granted'; "
                             "constructor(title) { localStorage.setItem('told', title); } };")  # fmt: skip
        page.goto(f"/jobs/{job}")
        page.get_by_label("Notify me when it is over").check()
        with there.database.transaction() as session:
            row = session.get_one(JobRow, job)
            row.state, row.finished_at = "failed", utc_now()
            row.error = {"code": "internal_error", "message": "It broke."}
        page.get_by_text("The job has failed.").wait_for()
        expect(page).to_have_title(re.compile("^✗ "))
        assert page.locator('link[rel="icon"]').get_attribute("href").startswith("data:image/svg")  # type: ignore[union-attr]
        assert "failed" in page.evaluate("localStorage.getItem('told')")
