"""A pose that somebody asks for: what versions say of it in numbers, as arrows, and in the address."""

from __future__ import annotations

import csv
import io
import re

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser

from kilter_core.twin import thesis_katana
from kilter_service.page.words import format_value_with_interval
from tests.service.conftest import Katana

from .conftest import opened
from .made import Made, made_fixtures
from .test_robot import arm_of, picture, tool, words

there, server = made_fixtures()


def part(there: Made, **asked: str) -> str:
    answer = there.client.get(f"/robots/{there.robot}/pose", params=asked, headers={"HX-Request": "true"})
    return answer.raise_for_status().text


def vectors(text: str) -> np.ndarray:
    found = re.search(r'data-vectors="([^"]*)"', text)
    assert found is not None
    return np.array([[float(v) for v in one.split()] for one in found[1].split(";")])


def joints(row: int) -> str:
    measured = Katana().columns(60, seed=3)
    return ",".join(str(measured[f"q{k}_deg"][row - 1]) for k in range(1, 6))


def nominal_errors(there: Made) -> np.ndarray:
    """Measured minus nominal (N, 3) mm: the poor version is the nominal robot."""
    answer = there.client.get(f"/v1/versions/{there.poor}/residuals", params={"campaign": there.campaign})
    rows = csv.DictReader(io.StringIO(answer.text))
    return np.array([[float(row[f"d{axis}_mm"]) for axis in "xyz"] for row in rows])


def test_what_the_version_moves_the_tool_by_is_what_the_nominal_robot_misses(there: Made) -> None:
    """The good version is the arm that was measured: both differ by the noise of 10 µm only."""
    missed = nominal_errors(there)
    for row in (1, 23, 60):
        by_row = vectors(part(there, version=there.good, campaign=there.campaign, row=str(row)))[0]
        by_joints = vectors(part(there, version=there.good, campaign=there.campaign, row=str(row), q=joints(row)))[0]
        assert np.linalg.norm(by_row - missed[row - 1]) < 0.05
        np.testing.assert_allclose(by_joints, by_row, atol=1e-9)


def test_the_tool_is_where_the_arm_is(there: Made) -> None:
    twin = thesis_katana()
    poses = ("10,40,20,15,30", "-80,10,60,-35,90")
    measured = twin.observe(np.radians([[float(v) for v in q.split(",")] for q in poses]), noise_m=0.0, seed=0).position
    assert measured is not None
    said = [words(part(there, version=there.good, q=q)) for q in poses]
    found = [re.search(r"x ([-\d.]+), y ([-\d.]+), z ([-\d.]+) mm", one) for one in said]
    places = [[float(v) for v in one.groups()] for one in found if one is not None]
    # The twin's base is moved but not rotated, so both frames see the same way from one place to the other.
    np.testing.assert_allclose(np.diff(places, axis=0), np.diff(measured * 1e3, axis=0), atol=0.05)
    assert "At j1 10.0°, j2 40.0°, j3 20.0°, j4 15.0°, j5 30.0°." in said[0]


def test_parts_have_intervals_where_something_is_known(there: Made) -> None:
    said = words(part(there, version=there.good, campaign=there.campaign, row="5"))
    # One length is known to 10 µm, so the geometry to at most 1.96 times that.
    found = re.search(r"geometry ([\d.]+) mm \(([\d.]+) to ([\d.]+)\)", said)
    assert found is not None, said
    size, low, high = (float(v) for v in found.groups())
    assert low < size < high
    assert high - low <= 2 * 1.96 * 0.01 + 2e-3
    assert re.search(r"known to 0\.01\d\d mm \(one standard deviation", said)
    assert "with the load, temperature and directions of row 5" in said


def test_a_length_and_its_interval_have_one_unit() -> None:
    assert format_value_with_interval(0.0408, 0.035, 0.047) == "41 µm (35 to 47)"
    assert format_value_with_interval(0.4592, 0.4555, 0.4629) == "0.4592 mm (0.4555 to 0.4629)"
    assert format_value_with_interval(0.09, 0.07, 0.11) == "0.090 mm (0.070 to 0.110)"  # the unit of the largest
    assert format_value_with_interval(0.4592, None, None) == "0.459 mm"


def test_two_versions_are_two_arrows(there: Made) -> None:
    both = vectors(part(there, version=there.good, other=there.poor, q="0,40,20,15,30"))
    assert both.shape == (2, 3)
    assert np.linalg.norm(both[0]) > 0.1
    assert np.linalg.norm(both[1]) < 1e-6  # the nominal robot moves nothing


def test_opened_alone_it_is_a_page(there: Made) -> None:
    answer = there.client.get(f"/robots/{there.robot}/pose", params={"version": there.good, "q": "0,40,20,15,30"})
    assert "<html" in answer.text
    assert "moves it by" in words(answer.text)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"q": "1,2"}, "has 5 joints, not 2"),
        ({"q": "a,b"}, "are not joints"),
        ({"q": "nan,0,0,0,0"}, "are not joints"),
        ({"row": "61"}, "has no row 61"),
    ],
)
def test_what_is_not_a_pose_is_refused_with_words(there: Made, asked: dict[str, str], said: str) -> None:
    whole = {"version": there.good, "campaign": there.campaign, **asked}
    answer = there.client.get(f"/robots/{there.robot}/pose", params=whole)
    assert (answer.status_code, said in words(answer.text)) == (422, True)


@pytest.mark.short_path
def test_the_pose_follows_the_sliders_and_stays_in_the_address(there: Made, chromium: Browser) -> None:
    with opened(chromium, there.client) as page:
        arm_of(page, there.robot, f"?campaign={there.campaign}&other={there.poor}")
        asked = page.locator("[data-asked][data-drawn='2']")
        asked.get_by_text("moves it by").first.wait_for()
        left = there.client.get(f"/v1/versions/{there.good}/residuals", params={"campaign": there.campaign}).text
        sizes = [sum(float(one[f"d{a}_mm"]) ** 2 for a in "xyz") for one in csv.DictReader(io.StringIO(left))]
        assert page.get_by_label("Measured row").input_value() == str(int(np.argmax(sizes)) + 1)
        assert "A cell of the grid is 100 mm" in page.locator("[data-grid]").inner_text()
        page.get_by_label("j1").press("End")
        asked.get_by_text("At j1 169.5°").wait_for()
        page.get_by_role("button", name="Turn left").click()
        page.wait_for_url(re.compile(r"[?&]q=.*camera="))
        there_was, place = tool(page), page.url
        seen = picture(page)
        found = Axe().run(page)
        assert found.violations_count == 0, found.generate_report()
        page.goto("/")
        page.goto(place)
        page.locator("[data-asked][data-drawn='2']").wait_for()
        assert tool(page) == pytest.approx(there_was, abs=0.05)
        assert np.abs(picture(page) - seen).mean() < 1.0
        page.wait_for_timeout(600)  # longer than the address waits before it says what was looked at
        assert page.url == place
