"""Dropping views: their cameras and boards are dropped after them, and what is wrong is said before anything is stored."""

from __future__ import annotations

import html
import json
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page

from tests.service.test_pixels import SCENE, columns, csv, described, seen

from .test_drop import campaigns_of, dropped, shown_sha256
from .test_login import logged_in, token_of


@pytest.fixture(scope="module")
def robot(server: httpx.Client) -> str:
    server.post("/v1/robots", json=SCENE.drawn.document() | {"name": "watched"}).raise_for_status()
    return "watched"


def views(**changes: Any) -> bytes:
    return csv(columns(seen(12)) | changes).encode()


def as_seen(**changes: Any) -> dict[str, Any]:
    """The JSON that `kilter measure see` writes, with more in it than a campaign has."""
    rig = described(SCENE)
    cameras = [one | {"serial": "A1"} for one in rig["cameras"]]
    return {"rows": 12, "views": [], "refused": []} | rig | {"cameras": cameras} | changes


def with_rig(server: httpx.Client, address: str, document: Any, name: str = "views.json") -> httpx.Response:
    content = document if isinstance(document, bytes) else json.dumps(document).encode()
    return server.post(f"{address}/rig", params={"name": name}, content=content)


def text_of(server: httpx.Client, address: str) -> str:
    return " ".join(html.unescape(server.get(address).raise_for_status().text).split())


def test_views_are_stored_with_the_cameras_that_were_dropped_after_them(server: httpx.Client, robot: str) -> None:
    address = dropped(server, robot, "views.csv", views())
    text = text_of(server, address)
    assert "These rows cannot be stored yet." in text
    assert "give the JSON that `kilter measure see` wrote beside them" in text
    form = {"sha256": shown_sha256(text), "name": "dropped views"}
    assert server.post(f"{address}/store", data=form).status_code >= 400
    assert with_rig(server, address, as_seen()).raise_for_status().json()["address"] == address
    text = text_of(server, address)
    assert "Understood." in text
    assert "camera cell, in the room, 1920 × 1080 px" in text
    assert "the board, on the flange, 48 corners" in text
    assert server.post(f"{address}/store", data=form).status_code == 303
    (made,) = [one for one in campaigns_of(server, robot) if one["name"] == "dropped views"]
    assert made["rows"] == 12
    assert made["conditions"]["cameras"][0]["fx_px"] == SCENE.eyes[0].focal[0]
    assert len(made["conditions"]["boards"][0]["corners_mm"]) == 48


@pytest.mark.parametrize(
    ("document", "said"),
    [
        (b"fx: 1500\n", "is not JSON"),
        ([1, 2], "views.json describes no cameras and boards."),
        ({"kind": "charuco", "columns": 9, "rows": 7}, "views.json describes no cameras and boards."),
        (as_seen(cameras=[]), "names no cameras. State the intrinsics when you run `kilter measure see`"),
        (as_seen(boards=[]), "names no boards."),
        (as_seen(cameras=[{"name": "cell", "mount": "fixed"}]), "cameras.0.fx_px: Field required"),
        (
            as_seen(cameras=[as_seen()["cameras"][0] | {"distortion": [0.1]}]),
            "distortion has 1 numbers, brown has 4 or 5",
        ),
        (as_seen(boards=as_seen()["boards"] * 2), "two have this name: give each its own"),
    ],
)
def test_a_description_that_cannot_be_is_refused_and_the_file_stays(
    server: httpx.Client, robot: str, document: Any, said: str
) -> None:
    address = dropped(server, robot, "views.csv", views())
    refused = with_rig(server, address, document)
    assert refused.status_code in (400, 422)
    assert said in " ".join(html.unescape(refused.text).split())
    assert with_rig(server, address, as_seen()).status_code == 200  # the remedy
    assert "Understood." in text_of(server, address)


@pytest.mark.parametrize(
    ("changes", "rows", "said"),
    [
        ({"cameras": [as_seen()["cameras"][0] | {"width_px": 800, "height_px": 600}]}, {},
         "is outside the picture of its camera: describe the camera that saw it"),
        ({"boards": [as_seen()["boards"][0] | {"corners_mm": as_seen()["boards"][0]["corners_mm"][:40]}]}, {},
         "is of a corner that the board does not have"),
        ({}, {"camera": ["door"] * 12}, "Row 1, column 'camera' is 'door'"),
        ({"cameras": [as_seen()["cameras"][0], as_seen()["cameras"][0] | {"name": "door"}]}, {},
         "Column 'camera' is missing: the campaign has 2 cameras"),
    ],
)  # fmt: skip
def test_what_these_cameras_cannot_have_seen_is_said_where_the_file_is_shown(
    server: httpx.Client, robot: str, changes: dict[str, Any], rows: dict[str, Any], said: str
) -> None:
    before = len(campaigns_of(server, robot))
    address = dropped(server, robot, "views.csv", views(**rows))
    with_rig(server, address, as_seen(**changes)).raise_for_status()
    text = text_of(server, address)
    assert said in text
    assert "These rows cannot be stored yet." in text
    assert len(campaigns_of(server, robot)) == before


def test_what_belongs_to_the_command_line_says_so(server: httpx.Client, robot: str) -> None:
    """Pictures, also such as would unpack to gigabytes, are not unpacked; boards and cameras are told where they go."""
    rig = json.dumps(as_seen(), indent=1).encode()
    board = json.dumps({"kind": "charuco", "columns": 9, "rows": 7, "square_mm": 30, "corners": []}).encode()
    info = b"image_width: 640\nimage_height: 480\ncamera_name: cell\ncamera_matrix:\n  rows: 3\n"
    for name, content, said in (
        ("shot.png", b"\x89PNG\r\n\x1a\n" + b"\xff" * 4096, "found with kilter measure see"),
        ("shot.bmp", b"BM" + b"\xff" * 4 + bytes(4) + b"\xff" * 4096, "found with kilter measure see"),
        ("run.mp4", b"\0\0\0\x18ftypisom" + b"\xff" * 4096, "found with kilter measure see"),
        ("board.json", board, "is the description of a printed board. Give it to kilter measure see (--board)"),
        ("views.json", rig, "on the page drop the views first, and it after them"),
        ("camera.yaml", info, "Give it to kilter measure see (--camera)"),
    ):
        text = text_of(server, dropped(server, robot, name, content))
        assert said in text, (name, text[:2000])
        assert "This file cannot be read." in text, name
        assert 'id="store"' not in text, name


def test_viewers_describe_no_cameras(server: httpx.Client, robot: str) -> None:
    address = dropped(server, robot, "views.csv", views())
    with logged_in(server, token_of(server, "viewer", "looks-at-views")["token"]) as viewer:
        assert with_rig(viewer, address, as_seen()).status_code == 403


@pytest.mark.short_path
def test_people_drop_views_and_their_cameras(page: Page, server: httpx.Client, robot: str, tmp_path: Path) -> None:
    rows, rig = tmp_path / "views.csv", tmp_path / "views.json"
    rows.write_bytes(views())
    rig.write_text(json.dumps(as_seen(cameras=[])))
    page.goto(f"/robots/{robot}/campaigns/new")
    page.locator("#file").set_input_files(rows)
    page.wait_for_url("**/campaigns/new/*")
    page.get_by_text("These rows cannot be stored yet.").wait_for()
    page.locator("#rig-file").set_input_files(rig)
    page.get_by_text("names no cameras").wait_for()
    rig.write_text(json.dumps(as_seen()))
    page.locator("#rig-file").set_input_files(rig)
    page.get_by_text("camera cell, in the room").wait_for()
    page.get_by_text("Understood.").wait_for()
    page.get_by_label("Name", exact=True).fill(f"views {page.viewport_size}")
    page.get_by_role("button", name="Store", exact=True).click()
    page.wait_for_url("**/campaigns/cmp_*")
