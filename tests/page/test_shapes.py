"""The shapes of the links on the page of a robot: sent, replaced, removed, and refused with words."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser

from tests.service.conftest import Katana

from .conftest import opened
from .test_login import csrf, logged_in, token_of

BOX = "v -60 -60 0\nv 60 -60 0\nv 60 60 0\nv -60 60 0\nv 0 0 250\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\nf 1 2 3 4\n"
PLACE = "/robots/arm/meshes/j2"


@pytest.fixture(autouse=True, scope="module")
def robot(server: httpx.Client) -> None:
    """A robot to draw."""
    server.post("/v1/robots", json={**Katana.document, "name": "arm"}).raise_for_status()


@pytest.fixture
def admin(server: httpx.Client) -> Iterator[httpx.Client]:
    """An admin who logged in, with the page's own token."""
    with logged_in(server, server.headers["authorization"].removeprefix("Bearer ")) as client:
        client.headers.update(csrf(client))
        yield client


def test_a_shape_is_sent_replaced_and_removed(admin: httpx.Client) -> None:
    for unit, shown in (("mm", "mm"), ("m", "m")):
        answer = admin.post(PLACE, params={"name": "Link 2.OBJ", "unit": unit}, content=BOX)
        assert (answer.status_code, answer.headers["hx-refresh"]) == (204, "true")
        assert f"<td>OBJ</td><td>{shown}</td>" in admin.get("/robots/arm/settings").text
    assert admin.post(f"{PLACE}/remove").status_code == 204
    assert "No link has a shape" in admin.get("/robots/arm/settings").text


@pytest.mark.parametrize(
    ("place", "name", "content", "status", "words"),
    [
        (PLACE, "link.step", BOX, 415, "ends in .stl or .obj"),
        (PLACE, "", BOX, 415, "without a name"),
        (PLACE, "link.obj", "v 0 0 0", 400, "no triangle"),
        (PLACE, "link.stl", b"0" * ((16 << 20) + 1), 413, "larger than 16 MB"),
        ("/robots/arm/meshes/j99", "link.obj", BOX, 400, "There are base, "),
        (f"{PLACE}/remove", "", "", 404, "has no mesh"),
    ],
)
def test_refusals_say_what_to_do(
    admin: httpx.Client, place: str, name: str, content: str | bytes, status: int, words: str
) -> None:
    answer = admin.post(place, params={"name": name}, content=content, headers={"HX-Request": "true"})
    assert (answer.status_code, words in answer.text) == (status, True), answer.text
    assert "<html" not in answer.text


def test_who_may_not_change_robots_sees_no_form(server: httpx.Client, admin: httpx.Client) -> None:
    assert "data-send-shape" in admin.get("/robots/arm/settings").text
    with logged_in(server, token_of(server, "operator", "no-shapes")["token"]) as client:
        text = client.get("/robots/arm/settings").text
        assert "data-send-shape" not in text
        assert "needs the role admin" in text
        for place in (PLACE, f"{PLACE}/remove"):
            assert client.post(place, params={"name": "a.obj"}, content=BOX, headers=csrf(client)).status_code == 403
    del admin.headers["x-csrf-token"]
    assert admin.post(PLACE, params={"name": "a.obj"}, content=BOX).status_code == 403


@pytest.mark.parametrize("size", ["desktop", "tablet"])
def test_the_form_works(server: httpx.Client, chromium: Browser, tmp_path: Path, size: str) -> None:
    good, bad = tmp_path / "link2.obj", tmp_path / "bad.stl"
    good.write_text(BOX, encoding="utf-8")
    bad.write_text("nothing", encoding="utf-8")
    with opened(chromium, server, size) as page:
        page.goto("/robots/arm/settings")
        shapes = page.locator("#shapes")
        shapes.get_by_label("Link", exact=True).select_option("j2")
        shapes.get_by_label("STL or OBJ file").set_input_files(bad)
        shapes.get_by_role("button", name="Give the link").press("Enter")
        shapes.get_by_text("This cannot be a mesh").wait_for()
        shapes.get_by_label("STL or OBJ file").set_input_files(good)
        shapes.get_by_role("button", name="Give the link").press("Enter")
        remove = shapes.get_by_role("button", name="Remove the shape of j2")
        remove.wait_for()
        shapes.screenshot(path=tmp_path / f"{size}.png")
        found = Axe().run(page)
        assert found.violations_count == 0, found.generate_report()
        remove.press("Enter")
        shapes.get_by_text("No link has a shape").wait_for(state="attached")
