"""Figures: what is written along an axis can be read."""

from __future__ import annotations

import re
from itertools import pairwise

import httpx
import pytest
from playwright.sync_api import Browser

from kilter_service.page.figures import plot as room
from kilter_service.page.figures.plot import LEFT, RIGHT, Plot, around, category_axis, days_around

from .conftest import opened
from .made import Made, made_fixtures

there, server = made_fixtures()


def drawn(names: list[str], width: float = 760.0) -> str:
    plot = Plot("errors", category_axis("parameter", names), around("mm", [1.0], zero=True), width)
    return str(plot.bars([k + 0.5 for k in range(len(names))], [1.0] * len(names), 0.6, "mean").svg())


def test_names_along_an_axis_stay_whole() -> None:
    names = [f"backlash_load_{joint}" for joint in range(20)]
    svg = drawn(names)
    turned = re.findall(r'<text transform="translate\(([\d.]+) [\d.]+\) rotate\(-45\)" text-anchor="end">([^<]*)<', svg)
    assert [name for _, name in turned] == names
    places = [float(x) for x, _ in turned]
    assert min(b - a for a, b in pairwise(places)) > 17  # a slanted line of text
    assert places[0] - 0.71 * 6.6 * len(names[0]) > 0  # it begins within the picture
    assert float(re.findall(r'height="([\d.]+)"', svg)[0]) > float(
        re.findall(r'height="([\d.]+)"', drawn(["a", "b"]))[0]
    )


def test_names_that_have_room_are_level() -> None:
    svg = drawn(["Before", "Registration only", "After"])
    assert "rotate(-45)" not in svg
    assert 'text-anchor="middle">Registration only<' in svg


def test_more_names_than_there_is_room_are_thinned() -> None:
    shown = re.findall(r'rotate\(-45\)" text-anchor="end">([^<]*)<', drawn([f"name_{k}" for k in range(200)]))
    assert 10 < len(shown) < (760 - LEFT - RIGHT) / 17


@pytest.mark.parametrize("width", [480.0, 338.0, 260.0])
def test_dates_along_an_axis_stay_within_the_picture_and_apart(width: float) -> None:
    cut = 0
    for last in range(2, 400):
        plot = Plot("checks", days_around("", [20_698.0, 20_698.0 + last]), around("", [1.0]), width)
        svg = str(plot.svg())
        shown = re.findall(r'<text x="([\d.]+)" y="[\d.]+" text-anchor="middle">(\d{4}-\d\d-\d\d)<', svg)
        places = [float(x) for x, _ in shown]
        assert places, last
        assert min(places) - 35 >= 0, last  # half of ten digits of a wide font
        assert max(places) + 35 <= width, last
        assert all(b - a >= 66 for a, b in pairwise(places)), (last, places)
        cut += plot._px(max(x for x, _ in plot._x_ticks())) + 35 > width
    assert cut  # dates that stood at their ticks would have been cut


def widths(there: Made, path: str, told: str | None) -> set[float]:
    """Widths of the figures of a view for a browser whose window is so wide."""
    cookies = {} if told is None else {room.COOKIE: told}
    with httpx.Client(
        base_url=there.client.base_url, headers=there.client.headers, cookies=cookies, timeout=60
    ) as client:
        text = client.get(path).raise_for_status().text
    return {float(one) for one in re.findall(r'<svg xmlns[^>]* role="img" width="([\d.]+)"', text)}


def test_figures_are_as_wide_as_the_window_has_room(there: Made) -> None:
    path = f"/versions/{there.poor}/compare/{there.good}?campaign={there.campaign}"
    assert widths(there, path, None) == {640.0, 480.0}
    assert widths(there, path, "1440") == {640.0, 480.0}
    assert widths(there, path, "390") == {338.0}
    assert widths(there, path, "1") == {260.0}
    for nonsense in ("-390", "39e1", "", "39.0", "9" * 40, "x"):
        assert widths(there, path, nonsense) == {640.0, 480.0}, nonsense


def test_a_report_is_as_wide_as_paper_for_every_window(there: Made) -> None:
    path = f"/versions/{there.good}/report"
    assert widths(there, path, "390") == widths(there, path, None) != set()


def test_letters_of_figures_can_be_read_on_a_telephone(there: Made, chromium: Browser) -> None:
    """Drawn for a desktop and made smaller, they were 6 px high."""
    with opened(chromium, there.client) as page:
        page.set_viewport_size({"width": 390, "height": 844})
        compared = f"/versions/{there.poor}/compare/{there.good}?campaign={there.campaign}"
        for view in (f"/robots/{there.robot}/versions", compared, f"/campaigns/{there.campaign}"):
            page.goto(view)
            page.locator("figure svg text").first.wait_for()
            page.reload()  # the first view of a window that was wide is still drawn for it
            page.locator("figure svg text").first.wait_for()
            heights = page.locator("figure svg text").evaluate_all(
                "texts => texts.map(one => [one.getScreenCTM(), parseFloat(getComputedStyle(one).fontSize)])"
                ".map(([m, size]) => Math.hypot(m.a, m.b) * size)"
            )
            assert len(heights) > 5
            assert min(heights) >= 10, (view, min(heights))
            assert page.evaluate("document.documentElement.scrollWidth") <= 390, view
