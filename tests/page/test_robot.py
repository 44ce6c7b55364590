"""The first view of a robot: the answers nearest the top, and the arm in 3-D."""

from __future__ import annotations

import csv
import gzip
import html
import io
import re
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from PIL import Image
from playwright.sync_api import Browser, Page

from kilter_service.page.answers import FOLDER, hashed_file_name
from kilter_service.versions.predictions.places import WORST, spread
from tests.core.palletiser import palletiser, said

from .conftest import opened
from .made import SCRIPT, Made, made

STATIC = Path(__file__).resolve().parents[2] / "service" / "kilter_service" / "page" / FOLDER
OTHER = {"name": "other", "convention": "preset", "preset": "katana450-chapter5"}


@pytest.fixture(scope="module")
def there(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Iterator[Made]:
    with made(tmp_path_factory.mktemp("robot"), migrated) as found:
        found.client.post("/v1/robots", json=OTHER).raise_for_status()
        found.client.post(f"/v1/versions/{found.poor}/activate").raise_for_status()
        found.client.post(f"/v1/versions/{found.good}/activate").raise_for_status()
        yield found


@pytest.fixture(scope="module")
def server(there: Made) -> httpx.Client:
    return there.client


def words(text: str) -> str:
    return html.unescape(re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", text)))


def errors(there: Made) -> np.ndarray:
    """Errors (N, 3) mm of the good version as the interface has them."""
    answer = there.client.get(f"/v1/versions/{there.good}/residuals", params={"campaign": there.campaign})
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    return np.array([[float(row[f"d{axis}_mm"]) for axis in "xyz"] for row in rows])


def numbers(there: Made, name: str, **asked: str) -> dict:  # type: ignore[type-arg]
    return there.client.get(f"/robots/{there.robot}/{name}.json", params=asked).raise_for_status().json()


def places(there: Made, version: str) -> dict:  # type: ignore[type-arg]
    return numbers(there, "places", version=version, campaign=there.campaign)


def test_the_questions_are_answered_at_the_top(there: Made) -> None:
    text = there.client.get(f"/robots/{there.robot}").text
    said = words(text)
    assert re.search(r"20\.0 µm .*mean error on held-out poses", said)
    assert "Without the version 1.25 mm" in said.replace("1250 µm", "1.25 mm")
    assert re.search(r"geometry 0\.930 mm corrected", said)  # 0.95 with base and tool alone, 0.02 with it
    assert re.search(r"Activated 20\d\d-\d\d-\d\d \d\d:\d\d UTC by admin", said)
    assert "not identifiable: 2 parameters" in said
    for address in (
        f"/versions/{there.good}", f"/robots/{there.robot}/versions", f"/robots/{there.robot}/stream",
        f"/versions/{there.good}/report", f"/robots/{there.robot}/jobs?kind=gap", f"/versions/{there.good}#unseen",
        f"/versions/{there.good}#suspicious",
    ):  # fmt: skip
        assert f'href="{address}"' in text, address


def test_the_worst_place_is_that_of_the_residuals(there: Made) -> None:
    asked = {"version": there.good, "campaign": there.campaign}
    part = there.client.get(f"/robots/{there.robot}/worst", params=asked, headers={"HX-Request": "true"})
    said = words(part.text)
    size = np.linalg.norm(errors(there), axis=1) * 1e3
    assert said.lstrip().startswith(f"{size.max():.1f} µm at x")
    assert " Error, µm " in said  # the head of the column, in which the cells are numbers
    assert f" {size.argmax() + 1} {size.max():.1f} " in said


def test_arrows_are_what_the_residuals_say(there: Made) -> None:
    shown = places(there, there.good)
    assert shown["row"] == list(range(1, 61))
    # The twin's base is not rotated, so the axes of the measurements are those of the picture.
    # Sent to 0.1 µm.
    np.testing.assert_allclose(shown["left"]["identified"], errors(there), atol=6e-5)
    measured = there.client.get(f"/v1/versions/{there.poor}/residuals", params={"campaign": there.campaign}).text
    rows = list(csv.DictReader(io.StringIO(measured)))
    nominal = [[float(row[f"d{axis}_mm"]) for axis in "xyz"] for row in rows]
    np.testing.assert_allclose(shown["left"]["nominal"], nominal, atol=6e-5)  # the poor version is the nominal robot
    plain = np.linalg.norm(shown["left"]["registration_only"], axis=1)
    assert plain.mean() < np.linalg.norm(nominal, axis=1).mean()
    assert all(shown["held_out"])


def test_the_workspace_says_the_error_before_and_what_is_not_known_after(there: Made) -> None:
    good, poor = (numbers(there, "reach", version=version) for version in (there.good, there.poor))
    assert len(good["at"]) == len(good["before"]) == len(good["after"]) > 2000
    assert np.mean(good["before"]) > 0.3
    assert max(poor["before"]) < 1e-3  # the nominal robot corrects nothing
    # 10 µm of a length and 10 µm that the fit left: between the one and both together.
    assert min(good["after"]) >= 0.01 - 1e-5
    assert max(good["after"]) <= np.hypot(0.01, 0.01) + 1e-4


def test_many_rows_keep_the_worst_and_the_outermost() -> None:
    rng = np.random.default_rng(5)
    at, size = rng.normal(size=(50_000, 3)), rng.exponential(size=50_000)
    kept = spread(at, size, most=5000)
    assert len(kept) <= 5000
    assert set(np.argsort(-size)[:WORST]) <= set(kept)
    assert {*at.argmin(axis=0), *at.argmax(axis=0)} <= set(kept)
    assert np.histogram(kept, bins=10, range=(0, 50_000))[0].min() > 300


def test_what_does_not_belong_together_is_refused_with_words(there: Made) -> None:
    wrong = there.client.get("/robots/other/reach.json", params={"version": there.good})
    assert (wrong.status_code, "is of robot 'katana'" in words(wrong.text)) == (400, True)
    assert there.client.get("/robots/nobody").status_code == 404


def test_what_people_wrote_is_text(there: Made) -> None:
    there.client.patch("/v1/robots/other", json={"remarks": SCRIPT}).raise_for_status()
    there.client.post("/v1/robots/other/campaigns", json={"name": SCRIPT}).raise_for_status()
    text = there.client.get("/robots/other").text
    assert SCRIPT not in text
    assert "&lt;script&gt;" in text


def test_the_bundle_is_small() -> None:
    assert len(gzip.compress((STATIC / hashed_file_name("arm.js")).read_bytes(), 9)) <= 160_000


def arm_of(page: Page, robot: str, query: str = "") -> None:
    page.goto(f"/robots/{robot}{query}")
    page.locator("[data-arm][data-ready]").wait_for()
    controls = page.locator("details.controls")
    if controls.get_attribute("open") is None:
        controls.locator("summary").first.click()
    rows = page.locator("details[data-rows-fold]")
    if rows.count() and rows.get_attribute("open") is None:
        rows.locator("summary").first.click()


def tool(page: Page) -> list[float]:
    return [float(v) for v in str(page.locator("[data-arm]").get_attribute("data-tool")).split()]


def picture(page: Page) -> np.ndarray:
    shot = page.locator("[data-arm] canvas[tabindex]").screenshot()
    return np.asarray(Image.open(io.BytesIO(shot)).convert("L"), dtype=float)


def test_a_linkage_is_drawn_and_no_other_drive(there: Made, page: Page) -> None:
    """Rods from the axis of the joint that drives to the axis that they tie to it, beside the links."""
    seen = {}
    for drive in ("linkage", "series"):
        document = said(palletiser(), drive) | {"name": f"palletiser-{drive}"}
        there.client.post("/v1/robots", json=document).raise_for_status()
        drawn = there.client.get(f"/robots/palletiser-{drive}/arm.json").raise_for_status().json()
        assert [[drawn["elements"][k][2] for k in pair] for pair in drawn["linkages"]] == [[1, 1]] * (
            drive == "linkage"
        )
        arm_of(page, f"palletiser-{drive}")
        seen[drive] = picture(page)
    assert np.abs(seen["linkage"] - seen["series"]).max() > 20.0


@pytest.mark.short_path
def test_the_arm_is_drawn_and_follows_its_controls(there: Made, page: Page) -> None:
    arm_of(page, there.robot)
    shown = places(there, there.good)
    before = picture(page)
    assert before.std() > 5.0  # not blank
    # Kinematics of the browser and of the core agree but for what the version corrects.
    worst = np.linalg.norm(errors(there), axis=1).argmax()
    assert np.linalg.norm(np.subtract(tool(page), shown["at"][worst])) < 5.0
    page.get_by_label("Measured row").fill("7")
    page.get_by_label("Measured row").blur()
    page.get_by_text("drawn at row 7,").wait_for()
    assert np.linalg.norm(np.subtract(tool(page), shown["at"][6])) < 5.0
    assert np.abs(picture(page) - before).mean() > 0.2
    turned = picture(page)
    page.get_by_role("button", name="Turn left").click()
    assert np.abs(picture(page) - turned).mean() > 0.2
    turned = picture(page)
    page.locator("[data-arm] canvas[tabindex]").press("ArrowUp")
    assert np.abs(picture(page) - turned).mean() > 0.2
    before_turning = tool(page)
    page.get_by_label("j1").press("End")
    assert np.linalg.norm(np.subtract(tool(page), before_turning)) > 20.0
    assert tool(page)[2] == before_turning[2]  # the first axis is upright


def test_the_picture_has_its_numbers_in_tables(there: Made, chromium: Browser) -> None:
    with opened(chromium, there.client) as page:
        arm_of(page, there.robot)
        page.get_by_text("Numbers of the picture").click()
        size = np.linalg.norm(errors(there), axis=1)
        first = page.locator('[data-table="places"] tbody tr').first.inner_text().split()
        assert int(first[0]) == size.argmax() + 1
        assert float(first[7]) == pytest.approx(size.max(), abs=1e-4)
        assert page.locator('[data-table="places"] tbody tr').count() == 60
        assert (
            page.locator("[data-arrow-key] svg")
            .get_attribute("aria-label", timeout=5000)
            .startswith("Colours from 0, drawn")
        )
        assert re.search(
            r"Pale: the nominal arm, its difference \d+ times", page.locator("[data-grid]").text_content() or ""
        )
        blank = picture(page)
        page.get_by_label("Coloured by").select_option("after")
        page.get_by_role("img", name="Colours from 0 to").wait_for()
        assert np.abs(picture(page) - blank).mean() > 0.5
        assert "one standard deviation" in page.locator("[data-scale-words]").inner_text()
        assert "median" in page.locator('[data-table="reach"]').inner_text()
        page.get_by_label("Left by").select_option("nominal")
        mean = np.linalg.norm(places(there, there.good)["left"]["nominal"], axis=1).mean()
        assert f"the nominal robot leaves {mean:.2f} mm" in page.locator("[data-said]").inner_text()
        found = Axe().run(page)
        assert found.violations_count == 0, found.generate_report()


def test_a_robot_without_measurements_is_drawn_too(there: Made, chromium: Browser) -> None:
    with opened(chromium, there.client, "tablet") as page:
        arm_of(page, "other")
        assert picture(page).std() > 3.0
        assert "a version and a campaign are needed" in page.locator("[data-said]").inner_text()
        assert "Not calibrated" in page.locator("main").inner_text()


def test_the_shape_of_a_link_is_drawn_in_its_place(there: Made, chromium: Browser) -> None:
    box = (
        "v -60 -60 0\nv 60 -60 0\nv 60 60 0\nv -60 60 0\nv 0 0 250\n"
        + "f 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\nf 1 2 3 4\n"
    )
    with opened(chromium, there.client) as page:
        arm_of(page, "other")
        plain = picture(page)
        address = "/v1/robots/other/meshes/j1"
        there.client.put(address, content=box, headers={"Content-Type": "model/obj"}).raise_for_status()
        corners = np.frombuffer(there.client.get("/robots/other/meshes/j1").content, dtype="<f4").reshape(-1, 3, 3)
        assert len(corners) == 6
        assert corners.max() == 250.0
        arm_of(page, "other")
        assert np.abs(picture(page) - plain).mean() > 0.5
        there.client.delete(address).raise_for_status()
        arm_of(page, "other")
        assert np.abs(picture(page) - plain).mean() < 0.2


def test_the_form_about_the_controller_is_of_ordinary_width(page: Page, there: Made) -> None:
    page.goto(f"/robots/{there.robot}/settings")
    chosen, button = page.locator("select[name=compensation]"), page.get_by_role("button", name="Say so")
    longest = max(chosen.locator("option").all_inner_texts(), key=len)
    box, card = chosen.bounding_box(), page.locator("section.card", has=chosen).bounding_box()
    assert box is not None
    assert card is not None
    assert box["width"] > 5.5 * len(longest)  # every answer is read whole
    assert card["x"] <= box["x"] < box["x"] + box["width"] <= card["x"] + card["width"]
    assert button.bounding_box()["height"] < 60.0  # type: ignore[index]  # on one line
