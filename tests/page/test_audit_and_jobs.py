"""The audit for admins, whole or said not to be; and the jobs of the whole server."""

from __future__ import annotations

import httpx
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser

from kilter_service.ground.errors import ServiceError
from kilter_service.web import audit
from tests.service.conftest import Katana

from .conftest import opened
from .test_login import logged_in, token_of

OTHER = {"name": "other-arm", "convention": "preset", "preset": "katana450-chapter5"}


@pytest.fixture(scope="module")
def job(server: httpx.Client) -> str:
    """A job that waits, for no worker runs; its name must be shown as text."""
    server.post("/v1/robots", json=OTHER).raise_for_status()
    campaign = Katana().campaign(server, 12, 1)
    new = {"kind": "identify", "robot": Katana.name, "name": "<script>alert(1)</script>", "campaigns": [campaign]}
    return str(server.post("/v1/jobs", json=new).raise_for_status().json()["id"])


def test_the_audit_is_shown_newest_first_and_found_by_robot_and_actor(server: httpx.Client, job: str) -> None:
    told = server.get("/v1/audit").json()["entries"]
    text = server.get("/audit").raise_for_status().text
    assert "The record is whole" in text
    assert f"{told[-1]['number']}:{told[-1]['sha256']}" in text
    assert text.count('<th scope="row" class="number">') == len(told)
    assert text.index(f'class="number">{told[-1]["number"]}<') < text.index(f'class="number">{told[0]["number"]}<')
    assert "<script>alert" not in text
    other = server.get("/audit", params={"robot": "other-arm"}).text
    assert other.count('<th scope="row" class="number">') == 1
    arm = server.get("/audit", params={"robot": Katana.name}).text
    assert "POST /v1/campaigns/{campaign}/observations" in arm  # names the campaign only
    assert "other-arm" not in arm.partition("<tbody>")[2]
    assert "None." in server.get("/audit", params={"actor": "nobody-of-that-name"}).text


def test_a_record_that_is_not_whole_is_said(server: httpx.Client, job: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ServiceError("Entry 3 of the audit is not what was written", code="audit_broken")

    monkeypatch.setattr(audit, "verify", broken)
    text = server.get("/audit").text
    assert "The record is not whole" in text
    assert "Entry 3" in text


@pytest.mark.parametrize("role", ["viewer", "operator"])
def test_only_admins_see_the_audit(server: httpx.Client, role: str) -> None:
    with logged_in(server, token_of(server, role, f"no-audit-{role}")["token"]) as client:
        assert client.get("/audit").status_code == 403
        assert 'href="/audit"' not in client.get("/").text


def test_all_jobs_are_listed(server: httpx.Client, job: str) -> None:
    text = server.get("/jobs").raise_for_status().text
    assert f"/jobs/{job}" in text
    assert "queued" in text
    assert "&lt;script&gt;" in text
    assert "<script>alert" not in text
    assert f"/jobs/{job}" in server.get("/jobs", params={"page": "nonsense"}).text


def test_both_stand_in_nobodys_way(chromium: Browser, server: httpx.Client, job: str) -> None:
    with opened(chromium, server) as page:
        for path in ("/audit", "/jobs"):
            page.goto(path)
            found = Axe().run(page)
            assert found.violations_count == 0, found.generate_report()
