"""A robot added on the page: described by preset, URDF or table, checked and drawn, and stored only then."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser

from .conftest import opened
from .test_login import csrf, logged_in, token_of

TABLE = "joint,theta_offset_deg,d_mm,a_mm,alpha_deg,lower_deg,upper_deg\nj1,0,200,0,90,-170,170\nj2,0,0,300,0,-90,90\n"
URDF = """<robot name="two"><link name="base"/><link name="one"/><link name="tip"/>
<joint name="a" type="revolute"><parent link="base"/><child link="one"/><origin xyz="0 0 0.2"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
<joint name="b" type="revolute"><parent link="one"/><child link="tip"/><origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


@pytest.fixture
def admin(server: httpx.Client) -> Iterator[httpx.Client]:
    with logged_in(server, server.headers["authorization"].removeprefix("Bearer ")) as client:
        client.headers.update(csrf(client) | {"HX-Request": "true"})
        yield client


def checked(client: httpx.Client, **told: str) -> httpx.Response:
    return client.post("/new-robot/check", data=told)


def document(answer: httpx.Response) -> str:
    found = re.search(r'name="document" value="([^"]*)"', answer.raise_for_status().text)
    assert found is not None
    return html.unescape(found[1])


@pytest.mark.parametrize(
    ("told", "joints", "reach"),
    [
        ({"name": "by-preset", "preset": "ur10"}, 6, 1340.0),
        ({"name": "by-table", "text": TABLE, "file": "arm.csv", "table": "dh"}, 2, 300.0),
        ({"name": "by-urdf", "text": URDF, "file": "arm.urdf", "base_link": "base", "tip_link": "tip"}, 2, 300.0),
    ],
)
def test_a_robot_is_checked_drawn_and_added(
    server: httpx.Client, admin: httpx.Client, told: dict[str, str], joints: int, reach: float
) -> None:
    answer = checked(admin, compensation="none", **told)
    text = answer.text
    assert f"{joints} joints, reach" in text, text
    assert text.count("<svg") == 3
    assert server.get(f"/v1/robots/{told['name']}").status_code == 404  # nothing is stored yet
    said = float(re.search(r"reach ([\d.]+) mm", text)[1])  # type: ignore[index]
    assert abs(said - reach) < 15.0
    added = admin.post("/new-robot", data={"document": document(answer)})
    assert added.headers["hx-redirect"] == f"/robots/{told['name']}"
    stored = server.get(f"/v1/robots/{told['name']}").raise_for_status().json()
    assert (len(stored["joints"]), stored["controller_compensation"]) == (joints, "none")
    assert server.get("/v1/audit").json()["entries"][-1]["route"] == "POST /new-robot"


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ({"name": "x"}, "Choose a preset, or drop a file"),
        ({"name": "x", "text": URDF, "file": "arm.urdf"}, "which is its first link and which its last"),
        ({"name": "x", "text": "<robot", "file": "a.urdf", "base_link": "a", "tip_link": "b"}, "URDF"),
        ({"name": "x", "text": "[1", "file": "a.json"}, "is not JSON"),
        ({"name": "x", "text": "a", "file": "arm.step"}, "give a file that ends in"),
        ({"name": "no name", "preset": "ur10"}, "This does not describe a robot"),
        ({"name": "x", "text": TABLE, "file": "a.csv"}, "by Denavit and Hartenberg or by Craig"),
        ({"name": "x", "text": "joint,length\n1,2", "file": "a.csv", "table": "dh"}, "length"),
    ],
)
def test_what_is_not_a_robot_is_refused_with_words(admin: httpx.Client, told: dict[str, str], said: str) -> None:
    answer = checked(admin, **told)
    assert 400 <= answer.status_code < 500
    assert said in html.unescape(answer.text), answer.text
    assert "new-robot" not in answer.text  # the folder it was read in


def test_only_admins_add_robots(server: httpx.Client, admin: httpx.Client) -> None:
    found = document(checked(admin, name="theirs", preset="ur10"))
    with logged_in(server, token_of(server, "operator", "adds-none")["token"]) as client:
        headers = csrf(client)
        assert (
            "needs the role admin"
            in client.post("/new-robot/check", data={"name": "a", "preset": "ur10"}, headers=headers).text
        )
        assert client.post("/new-robot", data={"document": found}, headers=headers).status_code == 403
    broken = admin.post("/new-robot", data={"document": json.dumps({"name": "x"})})
    assert (broken.status_code, "This does not describe a robot" in broken.text) == (422, True)


@pytest.mark.short_path
def test_people_drop_a_table_and_add_it(chromium: Browser, server: httpx.Client, tmp_path: Path) -> None:
    file = tmp_path / "arm.csv"
    file.write_text(TABLE, encoding="ascii")
    with opened(chromium, server) as page:
        page.goto("/new-robot")
        page.locator("#robot-name").fill("dropped")
        page.locator("#description-file").set_input_files(file)
        page.get_by_text("arm.csv: check it").wait_for()
        page.get_by_label("Rows of a table are by").select_option("dh")
        page.get_by_role("button", name="Check and draw it").click()
        page.get_by_role("heading", name="dropped at zero").wait_for()
        found = Axe().run(page)
        assert found.violations_count == 0, found.generate_report()
        page.get_by_role("button", name="Add this robot").click()
        page.wait_for_url("**/robots/dropped")
