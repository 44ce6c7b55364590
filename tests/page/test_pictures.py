"""A camera calibration by the page alone: a board to print, its pictures with the joints, and the campaign that they become."""

from __future__ import annotations

import csv
import io
import json
import re
import subprocess
import sys
import threading
import zipfile
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, expect

from tests.clients.files.rig.see.boards import small
from tests.clients.files.rig.see.raycaster import Page as Paper
from tests.clients.files.rig.see.raycaster import clean, finished

from .conftest import opened
from .test_first_calibration import Person, Server, stage, there, work

__all__ = ["there"]

PRESET = "katana450-chapter5"
VIEWS = 14


@pytest.fixture(scope="module")
def robot(server: httpx.Client) -> str:
    document = {"name": "seen", "convention": "preset", "preset": PRESET}
    server.post("/v1/robots", json=document).raise_for_status()
    return "seen"


def downloaded(server: httpx.Client, robot: str, folder: Path) -> Path:
    """The board as the page gives it, unpacked."""
    asked = {"columns": 7, "rows": 5, "square_mm": 25}
    answer = server.get(f"/robots/{robot}/campaigns/new/board.zip", params=asked).raise_for_status()
    with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
        archive.extractall(folder)
    return folder / "board.json"


def photographed(board: Path, folder: Path) -> list[Path]:
    """Pictures of the board from many sides, and a table of the joints with their names."""
    document = json.loads(board.read_text())
    paper = Paper.read(board.with_suffix(".svg"), document)
    rng = np.random.default_rng(4)
    files, rows = [board], []
    for k in range(VIEWS):
        turn = (float(rng.uniform(-28, 28)), float(rng.uniform(-28, 28)), float(rng.uniform(-20, 20)))
        centre = (float(rng.uniform(-50, 50)), float(rng.uniform(-40, 40)), float(rng.uniform(300, 420)))
        shot = small(rotation_deg=turn, centre_mm=centre)
        files.append(folder / f"pose{k + 1}.png")
        assert cv2.imwrite(str(files[-1]), finished(clean(paper, document, shot), shot))
        rows.append([files[-1].name, *rng.uniform(-40, 40, 5).round(3)])
    files.append(folder / "empty.png")  # of the wall, where the board was out of sight
    assert cv2.imwrite(str(files[-1]), np.full((360, 480), 120, dtype=np.uint8))
    rows.append([files[-1].name, 0.0, 0.0, 0.0, 0.0, 0.0])
    files.append(folder / "joints.csv")
    with files[-1].open("w", newline="", encoding="utf-8") as out:
        csv.writer(out).writerows([["picture", *(f"q{j}_deg" for j in range(1, 6))], *rows])
    return files


@pytest.mark.short_path
def test_pictures_become_a_campaign_without_a_command(
    chromium: Browser, server: httpx.Client, robot: str, tmp_path: Path
) -> None:
    files = photographed(downloaded(server, robot, tmp_path), tmp_path)
    with opened(chromium, server) as page:
        page.goto(f"/robots/{robot}")
        page.get_by_role("link", name="Pictures of a board…").click()
        expect(page.get_by_role("button", name="Download to print")).to_be_visible()
        page.locator("#file").set_input_files(files)
        page.wait_for_url("**/campaigns/new/*", timeout=60_000)
        expect(page.get_by_text("Understood.", exact=True)).to_be_visible()
        expect(page.locator("#understood")).to_contain_text(f"{VIEWS} views of {VIEWS + 1} pictures")
        shown = page.locator(".pictures")
        expect(shown).to_contain_text(f"{VIEWS} of {VIEWS + 1} pictures show the board")
        expect(shown.locator("li.bad")).to_have_text(re.compile("empty.png no marker of"))
        expect(shown).to_contain_text(re.compile(r"pose3.png\s+24 corners"))
        expect(page.locator("#understood")).to_contain_text("the camera stands in the room")  # a guess, and says so
        expect(page.locator("#rig")).to_contain_text("in the room, 480 × 360 px")
        page.get_by_label("Read it", exact=True).select_option("views-flange")
        page.get_by_role("button", name="Read again").first.click()
        expect(page.locator("#understood")).not_to_contain_text("the camera stands in the room", timeout=60_000)
        page.reload()
        expect(page.locator("#rig")).to_contain_text("on the flange, 480 × 360 px")
        page.get_by_role("button", name="Store", exact=True).click()
        page.wait_for_url("**/campaigns/cmp_*")
    stored = server.get(f"/v1/campaigns/{page.url.rpartition('/')[2]}").raise_for_status().json()
    (camera,) = stored["conditions"]["cameras"]
    assert (stored["rows"], camera["mount"]) == (VIEWS, "flange")
    assert abs(camera["fx_px"] - 560.0) < 15.0  # of the lens that the pictures were made with


def photographed_in_mujoco(folder: Path) -> list[Path]:
    """Forty pictures of an arm that MuJoCo moves before a camera, the joints of each, and the arm as drawn."""
    twin = Path(__file__).parents[2] / "docs/tutorial/camera_twin.py"
    subprocess.run([sys.executable, twin, "draw", "board.json"], cwd=folder, check=True)
    return [folder / "board.json", folder / "joints.csv", *sorted((folder / "pictures").iterdir())]


@pytest.mark.slow
def test_an_arm_is_calibrated_with_a_camera_from_its_page(chromium: Browser, there: Server, tmp_path: Path) -> None:
    client, database = there
    with opened(chromium, client) as page:
        client.post("/v1/robots", json={"name": "bare", "convention": "preset", "preset": PRESET}).raise_for_status()
        page.goto("/robots/bare")
        with page.expect_download() as board:
            page.get_by_role("link", name="A board to print").click()
        with zipfile.ZipFile(board.value.path()) as archive:
            archive.extractall(tmp_path)
        files = photographed_in_mujoco(tmp_path)
        drawn = {
            "convention": "urdf",
            "urdf": (tmp_path / "arm.urdf").read_text(),
            "base_link": "base",
            "tip_link": "lj6",
        }
        client.post("/v1/robots", json={"name": "photographed", **drawn}).raise_for_status()
        person = Person(page)
        page.goto("/robots/photographed")
        stage(page, "Measure")
        page.locator("#first-file").set_input_files(files)
        page.wait_for_url("**/campaigns/new/*", timeout=120_000)
        expect(page.locator(".pictures h2")).to_have_text("40 of 40 pictures show the board")
        assert Axe().run(page).response["violations"] == []
        person.press("button", "^Store and identify$")
        page.wait_for_url("**/jobs/job_*", timeout=60_000)
        asked = client.get(f"/v1/jobs/{page.url.rpartition('/')[2]}").json()
        assert (asked["kind"], asked["validation"]) == ("identify", 0.25)
        page.goto("/robots/photographed")
        stage(page, "Identify and search")
        work(database, "identify")
        page.reload()
        stage(page, "Activate")
        person.press("button", "^Activate …$|^Activate [^…]*…$")
        person.press("button", "^Activate (now|anyway)")
        page.wait_for_url("**/robots/photographed")
        stage(page, "Correct")
        expect(page.locator("#first li.done")).to_have_count(5)
        assert person.count <= 3
    version = client.get("/v1/robots/photographed").json()["active_version"]
    held = client.get(f"/v1/versions/{version}").json()["metrics"]["validation"]
    assert held["identified"]["mean_mm"] < 0.05 < 1.0 < held["registration_only"]["mean_mm"]


def test_what_each_picture_shows_is_said_while_others_are_read(
    server: httpx.Client, robot: str, tmp_path: Path
) -> None:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as out:
        for file in photographed(downloaded(server, robot, tmp_path), tmp_path):
            out.write(file, file.name)
    place = f"/robots/{robot}/campaigns/new"
    assert "pictures show the board" not in server.get(f"{place}/reading").raise_for_status().text
    sent = threading.Thread(
        target=lambda: server.post(f"{place}/file", params={"name": "all.zip"}, content=archive.getvalue())
    )
    sent.start()
    seen = set()
    while sent.is_alive():
        said = re.search(r"\d+ of (\d+) pictures show the board", server.get(f"{place}/reading").text)
        seen |= {int(said[1])} if said else set()
    assert seen
    assert seen <= set(range(1, VIEWS + 2))


@pytest.mark.parametrize(
    ("left_out", "said"),
    [("board.json", "no JSON of a board"), ("joints.csv", "no table of joints")],
)
def test_what_is_missing_beside_the_pictures_is_said(
    server: httpx.Client, robot: str, tmp_path: Path, left_out: str, said: str
) -> None:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as out:
        for name in {"a.png", "b.png", "c.png", "board.json", "joints.csv"} - {left_out}:
            out.writestr(name, b"")
    address = server.post(
        f"/robots/{robot}/campaigns/new/file", params={"name": "all.zip"}, content=archive.getvalue()
    ).raise_for_status()
    assert said in server.get(address.json()["address"]).text


def test_a_board_that_cannot_be_is_refused(server: httpx.Client, robot: str) -> None:
    answer = server.get(
        f"/robots/{robot}/campaigns/new/board.zip", params={"columns": 60, "rows": 60, "square_mm": 400}
    )
    assert answer.status_code == 422
    assert "page" in answer.text
