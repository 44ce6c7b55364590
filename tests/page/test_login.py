"""Logging in with a token: the cookie, what it is good for, and what it is not."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path

import httpx
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page

from kilter_service.ground.db.row import utc_now
from kilter_service.ground.settings import Settings
from kilter_service.page.answers import POLICY
from kilter_service.page.routes import ROUTERS
from kilter_service.run.app import create_app
from kilter_service.web.auth.policy import PAGE_RULES
from kilter_service.web.auth.token import admin_token
from kilter_service.web.logins import COOKIE, CSRF_HEADER
from kilter_service.web.routing import GuardedRoute
from tests.service.conftest import ready, served

from .conftest import opened

NEW_ROBOT = {"name": "arm", "convention": "preset", "preset": "katana450-chapter5"}


def token_of(server: httpx.Client, role: str, name: str) -> dict[str, str]:
    made = server.post("/v1/tokens", json={"name": name, "role": role})
    return made.raise_for_status().json()


@contextmanager
def logged_in(server: httpx.Client, token: str) -> Iterator[httpx.Client]:
    """Somebody with the cookie and without a header."""
    with httpx.Client(base_url=server.base_url, timeout=60) as client:
        answer = client.post("/login", data={"token": token, "then": "/"})
        assert answer.status_code == 303, answer.text
        yield client


def csrf(client: httpx.Client) -> dict[str, str]:
    text = client.get("/").text
    return {CSRF_HEADER: text.partition('name="csrf" content="')[2].partition('"')[0]}


def test_every_route_of_the_page_has_a_stated_role() -> None:
    there = set()
    for route in (route for router in ROUTERS for route in router.routes):
        assert isinstance(route, GuardedRoute), route
        there |= {f"{method} {route.path}" for method in route.methods}
    assert there == set(PAGE_RULES), there ^ set(PAGE_RULES)


def test_the_cookie_is_out_of_reach_of_scripts_and_other_sites(server: httpx.Client) -> None:
    token = server.headers["authorization"].removeprefix("Bearer ")
    given = httpx.post(server.base_url.join("/login"), data={"token": token}, timeout=60).headers["set-cookie"]
    assert given.startswith(f"{COOKIE}=")
    assert {"httponly", "samesite=strict", "path=/"} <= {part.strip().lower() for part in given.split(";")}
    assert token not in given


def test_who_is_logged_in_has_the_role_of_the_token(server: httpx.Client) -> None:
    with logged_in(server, token_of(server, "viewer", "watcher")["token"]) as client:
        assert client.get("/v1/whoami").json()["role"] == "viewer"
        assert client.post("/v1/robots", json=NEW_ROBOT, headers=csrf(client)).json()["code"] == "role_too_low"


def test_a_change_needs_the_token_of_the_page(server: httpx.Client) -> None:
    with logged_in(server, server.headers["authorization"].removeprefix("Bearer ")) as client:
        for headers in ({}, {CSRF_HEADER: "0" * 64}):
            refused = client.post("/v1/robots", json=NEW_ROBOT, headers=headers)
            assert (refused.status_code, refused.json()["code"]) == (403, "csrf_missing")
        assert client.post("/v1/robots", json=NEW_ROBOT, headers=csrf(client)).status_code == 201


def test_the_login_ends_with_the_token_and_with_logging_out(server: httpx.Client) -> None:
    made = token_of(server, "operator", "short")
    with logged_in(server, made["token"]) as client:
        assert client.get("/v1/whoami").json()["role"] == "operator"
        kept = client.cookies[COOKIE]
        assert client.post("/logout").status_code == 303
        client.cookies.set(COOKIE, kept)
        assert client.get("/v1/whoami").json()["actor"] == "anybody"  # a plain read on this machine
    with logged_in(server, made["token"]) as client:
        server.delete(f"/v1/tokens/{made['id']}").raise_for_status()
        assert client.get("/v1/whoami").json()["code"] == "token_ended"
        assert client.get("/").headers["location"].startswith("/login")


def link_of(client: httpx.Client, **wanted: int) -> str:
    made = client.post("/v1/login-links", json=wanted).raise_for_status()
    assert made.headers["cache-control"] == "no-store"
    return str(made.json()["path"]).removeprefix("/login#")


def use(server: httpx.Client, secret: str) -> httpx.Response:
    return httpx.post(server.base_url.join("/login/link"), data={"link": secret, "then": "/jobs"}, timeout=60)


def test_a_link_logs_in_once_in_the_role_of_whoever_made_it(server: httpx.Client) -> None:
    token = token_of(server, "operator", "linked")["token"]
    with httpx.Client(base_url=server.base_url, headers={"Authorization": f"Bearer {token}"}, timeout=60) as client:
        secret = link_of(client)
    with httpx.Client(base_url=server.base_url, cookies={COOKIE: secret}) as other:
        assert other.get("/v1/whoami").json()["actor"] == "anybody"  # a link is no login before it is used up
    answer = use(server, secret)
    assert (answer.status_code, answer.headers["location"]) == (303, "/jobs")
    with httpx.Client(base_url=server.base_url, cookies={COOKIE: answer.cookies[COOKIE]}) as client:
        assert client.get("/v1/whoami").json()["role"] == "operator"
    again = use(server, secret)
    assert (again.status_code, "was used already" in again.text) == (401, True)
    assert "set-cookie" not in again.headers
    told = [(entry["actor"], entry["route"]) for entry in server.get("/v1/audit").json()["entries"]]
    assert ("linked", "POST /v1/login-links") in told
    assert ("linked", "POST /login/link") in told
    assert secret not in server.get("/v1/audit").text


def test_a_link_ends_with_its_minutes_and_with_its_token(server: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    secret = link_of(server, minutes=5)
    later = utc_now() + timedelta(minutes=5, seconds=1)
    monkeypatch.setattr("kilter_service.web.store.utc_now", lambda: later)
    assert use(server, secret).status_code == 401
    monkeypatch.undo()
    made = token_of(server, "viewer", "gone")
    with httpx.Client(base_url=server.base_url, headers={"Authorization": f"Bearer {made['token']}"}) as client:
        secret = link_of(client)
    server.delete(f"/v1/tokens/{made['id']}").raise_for_status()
    assert use(server, secret).status_code == 401
    assert httpx.post(server.base_url.join("/v1/login-links"), json={}).json()["code"] == "token_missing"


@pytest.mark.short_path
def test_people_open_a_link(chromium: Browser, server: httpx.Client) -> None:
    with opened(chromium, server, token=False) as page:
        page.goto(f"/login#{link_of(server)}")
        assert "#" not in page.url
        page.get_by_role("button", name="Log in by this link").click()
        page.get_by_text("admin (admin)").wait_for()


def test_a_wrong_token_is_refused_in_the_form(server: httpx.Client) -> None:
    refused = httpx.post(server.base_url.join("/login"), data={"token": "x" * 40}, timeout=60)
    assert refused.status_code == 401
    assert "not one of this server" in refused.text
    assert "set-cookie" not in refused.headers


def test_the_audit_says_who_logged_in_and_keeps_no_secret(server: httpx.Client) -> None:
    with logged_in(server, token_of(server, "operator", "anna")["token"]):
        pass
    entry = server.get("/v1/audit").json()["entries"][-1]
    assert (entry["actor"], entry["route"]) == ("anna", "POST /login")
    assert [change["thing"] for change in entry["changes"]] == ["login"]


def test_the_cookie_is_for_https_only_where_the_browser_speaks_it(tmp_path: Path, migrated: Path) -> None:
    settings = Settings(data=tmp_path, host="127.0.0.1", proxy="127.0.0.1", token=None)
    ready(settings, migrated)
    with served(create_app(settings), proxy_headers=False) as client:  # as `kilterd` serves it
        for scheme, secure in (("https", True), ("http", False)):
            sent = {"x-forwarded-proto": scheme, "x-forwarded-for": "192.0.2.1"}
            answer = client.post("/login", data={"token": admin_token(settings)}, headers=sent)
            assert ("secure" in answer.headers["set-cookie"].lower().replace(" ", "").split(";")) is secure


@pytest.mark.parametrize("then", ["https://elsewhere.test/", "//elsewhere.test", "/\\elsewhere.test", "javascript:x"])
def test_a_link_to_the_login_leads_nowhere_else(server: httpx.Client, then: str) -> None:
    token = server.headers["authorization"].removeprefix("Bearer ")
    answer = httpx.post(server.base_url.join("/login"), data={"token": token, "then": then}, timeout=60)
    assert answer.headers["location"] == "/"


def test_every_answer_has_the_policy(server: httpx.Client) -> None:
    for path in ("/", "/login"):
        answer = server.get(path)
        assert answer.headers["content-security-policy"] == POLICY
        assert answer.headers["cache-control"] == "no-store"
    assert "unsafe" not in POLICY


def test_assets_are_kept_and_packed(server: httpx.Client) -> None:
    address = server.get("/").text.partition('<script type="module" src="')[2].partition('"')[0]
    answer = server.get(address)
    assert "immutable" in answer.headers["cache-control"]
    assert answer.headers["content-encoding"] == "gzip"
    assert server.get("/assets/page.js").status_code == 404


@pytest.mark.short_path
def test_people_log_in_and_out(page: Page) -> None:
    assert page.get_by_text("admin (admin)").is_visible()
    page.get_by_role("button", name="Log out").click()
    page.get_by_role("link", name="Log in").wait_for()


def test_nothing_stands_in_the_way_of_anybody(chromium: Browser, server: httpx.Client) -> None:
    with opened(chromium, server, token=False) as page:
        for path in ("/login", "/"):
            page.goto(path)
            found = Axe().run(page)
            assert found.violations_count == 0, found.generate_report()
