"""The whole way on a real `kilterd serve`, at desktop and tablet size; the pictures stay in build/page-screenshots.

From a file of an instrument to corrected setpoints, and from a search to the poses that it asks for, by clicks; with what
goes wrong on the way.
"""

from __future__ import annotations

import csv
import json
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

from kilter_client.cli.demo import NOISE_MM, PRESET, STAGES
from kilter_core.plan.d_optimal import iso_poses
from kilter_core.twin import thesis_katana
from tests.page.conftest import log_in, opened
from tests.page.controlling import Controller
from tests.service.conftest import wait_for
from tests.service.test_gap import QUICK, Arm
from tests.service.test_serve import children
from tools.draw_page_picture import Lab, lab

PICTURES = Path(__file__).parents[2] / "build" / "page-screenshots"
LONG_MS = 120_000  # what computes, on a machine that does other things too


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """All processes, and a robot with an identified and active version."""
    with lab(tmp_path_factory.mktemp("journey")) as made:
        yield made


@pytest.fixture(scope="module")
def client(whole: Lab) -> Iterator[httpx.Client]:
    headers = {"Authorization": f"Bearer {whole.token}"}
    with httpx.Client(base_url=whole.server.url, headers=headers, timeout=30) as client:
        yield client


def keep(page: Page, name: str, size: str, dark: bool = False) -> None:
    """Keep a picture of the whole page, and one in the dark; hiding the caret would leave inline styles behind."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=PICTURES / f"{name}-{size}.png", full_page=True, caret="initial")
    if dark:
        page.emulate_media(color_scheme="dark")
        page.screenshot(path=PICTURES / f"{name}-{size}-dark.png", full_page=True, caret="initial")
        page.emulate_media(color_scheme="light")


def tracker_file(file: Path, poses: int, seed: int, names: tuple[str, ...] = ("u", "v", "w")) -> Path:
    """Write a file as a lab has it: what a tracker saw beside the joint log, semicolons and decimal commas."""
    twin = thesis_katana(PRESET)
    seen = twin.observe(iso_poses(twin.robot, poses, seed), noise_m=NOISE_MM / 1000.0, seed=seed)
    assert seen.position is not None
    with file.open("w", newline="", encoding="utf-8") as out:
        rows = csv.writer(out, delimiter=";")
        rows.writerow(
            ["Frame", *(f"A{joint + 1} [deg]" for joint in range(seen.q.shape[1])), *(f"{n} [mm]" for n in names)]
        )
        for frame, row in enumerate(np.hstack([np.degrees(seen.q), 1e3 * seen.position]), 1):
            rows.writerow([frame, *(f"{value:.6f}".replace(".", ",") for value in row)])
    return file


def drop(page: Page, file: Path) -> None:
    """Choose a file and wait until it was read."""
    page.locator("#file").set_input_files(file)
    page.wait_for_url(re.compile(r"/campaigns/new/[0-9a-f]+"))


def checked(page: Page) -> None:
    """Press Check and wait until Run is possible."""
    page.get_by_role("button", name="Check").click()
    expect(page.get_by_text("The check has passed.")).to_be_visible(timeout=LONG_MS)
    expect(page.get_by_role("button", name="Run")).to_be_enabled()


def finished(page: Page) -> None:
    """Wait until the job on the page has succeeded."""
    expect(page.locator("h1 .badge")).to_have_text("succeeded", timeout=LONG_MS)


def identified(page: Page, robot: str, effects: str) -> None:
    """Identify with the campaigns that are preset, and go to the version."""
    page.goto(f"/robots/{robot}/jobs")
    page.locator("#option-effects").fill(effects)
    checked(page)
    page.get_by_role("button", name="Run").click()
    page.wait_for_url("**/jobs/job_*")
    finished(page)
    page.get_by_role("link", name="Version, and activating it").click()
    page.wait_for_url("**/versions/ver_*")


@pytest.mark.short_path
@pytest.mark.parametrize("size", ["desktop", "tablet"])
def test_from_a_file_to_corrected_setpoints(
    chromium: Browser, whole: Lab, client: httpx.Client, tmp_path: Path, size: str
) -> None:
    robot = f"lab-{size}"
    document = {"name": robot, "convention": "preset", "preset": PRESET}
    client.post("/v1/robots", json=document).raise_for_status()
    with opened(chromium, client, size, token=False) as page:
        page.goto("/login")
        keep(page, "01-login", size, dark=True)
        log_in(page, whole.token)
        page.get_by_role("link", name=robot).first.click()
        page.wait_for_url(f"**/robots/{robot}")
        keep(page, "02-robot-new", size)
        page.get_by_role("navigation", name=f"Robot {robot}").get_by_role("link", name="Campaigns").click()
        page.get_by_role("link", name="New campaign").click()
        keep(page, "03-drop", size)

        odd = tmp_path / "tracker.xyz"
        odd.write_bytes(bytes(range(256)) * 40)
        drop(page, odd)
        expect(page.get_by_role("alert")).to_contain_text("tracker.xyz")
        keep(page, "04-drop-unreadable", size)
        page.get_by_role("button", name="Discard this file").click()
        page.wait_for_url("**/campaigns/new")

        drop(page, tracker_file(tmp_path / "monday.csv", 118, 1))
        expect(page.get_by_text("Not understood yet.")).to_be_visible()
        keep(page, "05-drop-open", size)
        for name, axis in zip("uvw", "xyz", strict=True):
            field = page.get_by_label(f"What {name} [mm] is", exact=True)
            with page.expect_response("**/columns"):
                field.select_option(axis)
        expect(page.get_by_text("Understood.", exact=True)).to_be_visible(timeout=15_000)
        expect(page.get_by_text("118 rows at 118 poses").first).to_be_visible()
        page.get_by_label("Measured with").fill("tracker")
        keep(page, "06-drop-understood", size, dark=True)
        page.get_by_role("button", name="Store", exact=True).click()
        page.wait_for_url("**/campaigns/cmp_*")
        keep(page, "07-campaign", size, dark=True)

        page.goto(f"/robots/{robot}/campaigns/new")
        drop(page, tracker_file(tmp_path / "tuesday.csv", 40, 2, ("X", "Y", "Z")))
        page.get_by_label("Meant for").select_option("validation")
        page.get_by_role("button", name="Store", exact=True).click()
        page.wait_for_url("**/campaigns/cmp_*")
        page.get_by_role("link", name="Identify or search").click()

        run = page.get_by_role("button", name="Run")
        expect(page.get_by_label("Use of monday")).to_have_value("train")
        expect(page.get_by_label("Use of tuesday")).to_have_value("validation")
        expect(run).to_be_disabled()
        keep(page, "08-form", size, dark=True)
        page.get_by_label("Use of monday").select_option("")
        page.get_by_role("button", name="Check").click()
        expect(page.locator("#check").get_by_role("alert")).to_contain_text("names no campaign")
        expect(run).to_be_disabled()
        keep(page, "09-check-refused", size)
        page.get_by_label("Use of monday").select_option("train")
        page.locator("#option-effects").fill(", ".join(STAGES["full tilting"]))
        page.locator("#job-name").fill(f"tilting-{size}")
        checked(page)
        keep(page, "10-check-passed", size)
        run.click()
        page.wait_for_url("**/jobs/job_*")
        keep(page, "11-job", size)
        finished(page)
        page.wait_for_load_state("networkidle")
        keep(page, "12-identified", size, dark=True)

        page.get_by_role("link", name="Version, and activating it").click()
        page.wait_for_url("**/versions/ver_*")
        version = page.url.rpartition("/")[2]
        page.wait_for_load_state("networkidle")
        keep(page, "13-version", size, dark=True)
        page.get_by_role("button", name="Activate…").click()
        dialog = page.get_by_role("dialog")
        expect(dialog.get_by_role("button", name="Activate now")).to_be_visible(timeout=LONG_MS)
        page.screenshot(path=PICTURES / f"14-activate-{size}.png", caret="initial")
        dialog.get_by_role("button", name="Activate now").click()
        page.wait_for_url(f"**/robots/{robot}", timeout=LONG_MS)
        expect(page.locator("table.six")).to_contain_text("by admin")
        keep(page, "15-versions", size)

        page.get_by_role("navigation", name=f"Robot {robot}").get_by_role("link", name="Stream").click()
        active = page.locator('[data-live="active"]')
        expect(active).to_have_text(f"tilting-{size}", timeout=15_000)
        expect(active.get_by_role("link")).to_have_attribute("href", f"/versions/{version}")
        with Controller(whole.server.data, robot, size) as controller:
            section = page.locator(f'.stream[data-name="{size}"]')
            expect(section.locator('[data-field="condition"]')).to_have_text("corrected", timeout=15_000)
            wait_for(lambda: controller.last is not None and controller.last.source == "corrected")
            page.wait_for_timeout(3000)
            keep(page, "16-stream", size, dark=True)

        identified(page, robot, "")
        page.get_by_role("button", name="Activate…").click()
        dialog = page.get_by_role("dialog")
        dialog.get_by_role("button", name="Activate now").click(timeout=LONG_MS)
        expect(dialog.get_by_role("alert")).to_contain_text("It was not activated.", timeout=LONG_MS)
        page.screenshot(path=PICTURES / f"17-activation-refused-{size}.png", caret="initial")
        dialog.get_by_role("button", name="Leave it as it is").click()
        assert client.get(f"/v1/robots/{robot}").json()["active_version"] == version
        page.goto(f"/robots/{robot}")
        page.wait_for_load_state("networkidle")
        keep(page, "18-robot", size)


@pytest.fixture(scope="module")
def arm(client: httpx.Client) -> Arm:
    """A robot with a hidden effect, and a campaign of it."""
    made = Arm(client)
    made.upload()
    return made


@pytest.mark.parametrize("size", ["desktop", "tablet"])
def test_a_search_its_story_and_what_it_asks_for(
    chromium: Browser, whole: Lab, client: httpx.Client, arm: Arm, tmp_path: Path, size: str
) -> None:
    with opened(chromium, client, size) as page:
        page.goto(f"/robots/{arm.name}/jobs")
        page.get_by_role("link", name="Search for what is missing").click()
        page.get_by_text("All other options").click()
        for name, value in QUICK.items():
            page.locator(f"#option-{name}").fill(", ".join(value) if isinstance(value, list) else str(value))
        page.locator("#option-permutations").fill("10000")  # so that it is not over before it is cancelled
        checked(page)
        keep(page, "20-search-checked", size)
        page.get_by_role("button", name="Run").click()
        page.wait_for_url("**/jobs/job_*")
        expect(page.get_by_role("heading", name="Computing")).to_be_visible(timeout=LONG_MS)
        expect(page.locator("#place")).to_contain_text("computes it")
        first = page.url
        keep(page, "21-searching", size)
        page.get_by_role("button", name="Cancel").click()
        expect(page.locator("h1 .badge")).to_have_text("cancelled", timeout=15_000)
        keep(page, "22-cancelled", size)
        page.get_by_role("link", name="Again, with changes").click()
        page.wait_for_url("**/jobs?*")
        page.eval_on_selector_all("details", "all => all.forEach((one) => (one.open = true))")
        page.locator("#option-permutations").fill(str(QUICK["permutations"]))
        checked(page)
        page.get_by_role("button", name="Run").click()
        page.wait_for_url(lambda address: "/jobs/job_" in address and address != first)
        finished(page)
        search = page.url.rpartition("/")[2]
        keep(page, "23-story", size, dark=True)
        page.goto(f"/jobs/{search}/report")
        keep(page, "24-report", size)

        page.goto(f"/jobs/{search}")
        page.locator(".decide summary").click()
        with page.expect_download() as poses:
            page.get_by_role("link", name="Download them").click()
        assert poses.value.suggested_filename == f"poses-{search}.csv"
        page.get_by_role("link", name="Drop their measurements here").click()
        keep(page, "25-drop-for-search", size)
        few = tmp_path / "next.csv"
        with few.open("w", newline="", encoding="utf-8") as out:
            rows = csv.writer(out)
            rows.writerow(arm.columns)
            rows.writerows(list(zip(*arm.columns.values(), strict=True))[: 12 + len(size)])
        drop(page, few)
        page.get_by_label("Name", exact=True).fill(f"next-{size}")
        page.get_by_role("button", name="Store", exact=True).click()
        page.wait_for_url(f"**/campaigns/cmp_*?job={search}")
        keep(page, "26-campaign-of-search", size)
        page.get_by_role("button", name="Search again with this campaign").click()
        page.wait_for_url("**/jobs/job_*")
        asked = client.get(f"/v1/jobs/{page.url.rpartition('/')[2]}").json()
        assert len(asked["campaigns"]) == 1 + len(client.get(f"/v1/jobs/{search}").json()["campaigns"])
        page.get_by_role("button", name="Cancel").click()
        expect(page.locator("h1 .badge")).to_have_text("cancelled", timeout=15_000)
        page.goto("/jobs")
        keep(page, "27-jobs", size, dark=True)


@pytest.mark.parametrize("size", ["desktop", "tablet"])
def test_from_the_login_to_the_live_stream(chromium: Browser, whole: Lab, client: httpx.Client, size: str) -> None:
    with opened(chromium, client, size) as page:
        expect(page.get_by_role("link", name=whole.robot)).to_be_visible()
        keep(page, "fleet", size)
        page.goto(f"/robots/{whole.robot}/stream")
        expect(page.locator('[data-live="corrector"]')).to_contain_text("answers; it started")
        expect(page.locator('[data-live="active"]').get_by_role("link")).to_have_attribute(
            "href", f"/versions/{whole.version}"
        )
        with Controller(whole.server.data, whole.robot, size) as controller:
            section = page.locator(f'.stream[data-name="{size}"]')
            expect(section.locator('[data-field="condition"]')).to_have_text("corrected")
            expect(section.locator('[data-field="tool"]')).to_have_text(re.compile(r"\d (mm|µm)"), timeout=15_000)
            page.wait_for_timeout(4000)
            keep(page, "stream", size)
            controller.outside = True
            wait_for(lambda: controller.last is not None and controller.last.source == "bypass")
            expect(page.locator('[data-live="bypass"]')).to_contain_text("JOINT_LIMIT")
            keep(page, "stream-bypass", size)
            controller.outside = False
            expect(page.locator('[data-live="bypass"]')).to_be_hidden(timeout=15_000)
        expect(section.locator('[data-field="condition"]')).to_have_text("no setpoints", timeout=15_000)


def test_a_robot_that_does_not_exist_and_one_that_never_moved(
    chromium: Browser, whole: Lab, client: httpx.Client
) -> None:
    document = {"name": "still", "convention": "preset", "preset": "katana450-chapter5"}
    client.post("/v1/robots", json=document).raise_for_status()
    with opened(chromium, client) as page:
        answer = page.goto("/robots/nobody/stream")
        assert answer is not None
        assert answer.status == 404
        expect(page.get_by_role("alert")).to_contain_text("nobody")
        page.goto("/robots/still/stream")
        expect(page.locator('[data-live="none"]')).to_contain_text("No stream has run")
        expect(page.locator('[data-live="active"]')).to_contain_text("every setpoint is refused")
        keep(page, "stream-none", "desktop")


def test_the_page_comes_back_when_the_server_does(chromium: Browser, whole: Lab, client: httpx.Client) -> None:
    supervisor = json.loads((whole.server.data / "server.json").read_text())["pid"]

    def updates(page: Page) -> int:
        return int(page.locator("[data-stream]").get_attribute("data-updates") or 0)

    with opened(chromium, client) as page, Controller(whole.server.data, whole.robot, "after"):
        page.goto(f"/robots/{whole.robot}/stream")
        condition = page.locator('.stream[data-name="after"] [data-field="condition"]')
        expect(condition).to_have_text("corrected", timeout=15_000)
        os.kill(children(supervisor)["api"], signal.SIGKILL)
        page.wait_for_timeout(1000)
        before = updates(page)
        wait_for(lambda: updates(page) > before + 10, 60.0)
        expect(page.locator('[data-live="stale"]')).to_be_hidden()
        expect(condition).to_have_text("corrected")
