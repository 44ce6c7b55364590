"""Who may do what on the page: what the command can, against the server's own answers."""

from __future__ import annotations

import re

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser

from .conftest import opened
from .made import Made, made_fixtures
from .test_robot import words

SECRET = re.compile(r"kilter_[A-Za-z0-9_-]{43}")
LONGEST = "a" * 64


there, server = made_fixtures(rows=12, active=False)


def as_token(there: Made, secret: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {secret}"}


def test_a_token_is_made_used_and_revoked(there: Made) -> None:
    asked = {"name": "anna", "role": "viewer", "robot": [there.robot], "days": "30"}
    answer = there.client.post("/access", data=asked)
    assert answer.status_code == 201, answer.text
    (secret,) = SECRET.findall(answer.text)
    who = there.client.get("/v1/whoami", headers=as_token(there, secret)).json()
    assert (who["actor"], who["role"], who["robots"]) == ("anna", "viewer", [there.robot])
    assert secret not in there.client.get("/access").text  # shown once
    (token,) = [one for one in there.client.get("/v1/tokens").json()["tokens"] if one["name"] == "anna"]
    assert there.client.get("/access", headers=as_token(there, secret)).status_code == 403
    assert there.client.post(f"/access/{token['id']}/revoke").status_code in (200, 303)
    assert there.client.get("/v1/whoami", headers=as_token(there, secret)).json()["code"] == "token_ended"
    assert "revoked" in words(there.client.get("/access").text)
    audit = words(there.client.get("/audit").text)
    assert "made a token" in audit
    assert "withdrew the token" in audit


@pytest.mark.parametrize("wrong", [{"name": "no blanks"}, {"name": "admin"}, {"role": "king"}, {"days": "-1"}])
def test_what_cannot_be_given_is_a_sentence(there: Made, wrong: dict[str, str]) -> None:
    answer = there.client.post("/access", data={"name": "bob", "role": "viewer", **wrong})
    assert (answer.status_code >= 400, "text/html" in answer.headers["content-type"]) == (True, True)
    assert "bob" not in [one["name"] for one in there.client.get("/v1/tokens").json()["tokens"]]


@pytest.mark.parametrize("width", [1440, 390])
def test_an_administrator_gives_access_in_the_browser(there: Made, chromium: Browser, width: int) -> None:
    there.client.post("/access", data={"name": LONGEST, "role": "operator", "robot": [there.robot]})
    with opened(chromium, there.client) as page:
        page.set_viewport_size({"width": width, "height": 900})
        page.goto("/access")
        page.get_by_label("For whom, or what for").fill(f"cell-{width}")
        page.get_by_label("Role", exact=True).first.select_option("operator")
        page.get_by_role("button", name="Make a token").click()
        page.get_by_text("shown this once only").wait_for()
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        found = Axe().run(page)
        assert found.violations_count == 0, found.generate_report()
        page.reload()
        page.on("dialog", lambda dialog: dialog.accept())
        page.get_by_role("button", name=f"Revoke cell-{width}").click()
        page.locator("tr", has_text=f"cell-{width}").get_by_text("revoked").wait_for()
