"""Parameters as dots over what was known before: drawn where the numbers are, the clearest change first."""

from __future__ import annotations

import re

from kilter_service.contract.fits import Parameter
from kilter_service.page.shared.naming import parameter_rows


def row(name: str, change: float, sigma: float, **more: float) -> Parameter:
    return Parameter(name=name, unit="mm", value=100.0 + change, nominal=100.0, change=change, sigma=sigma, **more)


def places(drawn: str) -> tuple[float, float, float, float, float]:
    """Middle, dot, ends of the whisker, and width of the band, in pixels."""
    middle = re.search(r'class="decade" d="M([\d.]+) 0', drawn)
    whisker = re.search(r'class="whisker" d="M([\d.]+) [\d.]+H([\d.]+)"', drawn)
    dot, band = re.search(r'cx="([\d.]+)"', drawn), re.search(r'class="prior" x="[\d.]+" y="4" width="([\d.]+)"', drawn)
    assert middle is not None
    assert whisker is not None
    assert dot is not None
    assert band is not None
    return float(middle[1]), float(dot[1]), float(whisker[1]), float(whisker[2]), float(band[1])


def test_the_clearest_change_is_first() -> None:
    found = parameter_rows([row("a", 0.1, 0.1), row("b", -0.5, 0.01), row("c", 0.3, 0.1)], {})
    assert [one.parameter.name for one in found] == ["b", "c", "a"]
    assert all(one.drawn == "" for one in found)  # nothing says what was known before


def test_dot_interval_and_band_are_to_one_scale() -> None:
    (found,) = parameter_rows([row("a", 2.0, 0.5)], {"a": 5.0})
    middle, dot, low, high, band = places(str(found.drawn))
    pixels_per_mm = band / 10.0  # one standard deviation to either side
    assert abs(dot - middle - 2.0 * pixels_per_mm) < 0.2
    assert abs(high - low - 2 * 1.96 * 0.5 * pixels_per_mm) < 0.3
    assert "4.0 standard deviations" in str(found.drawn)


def test_an_interval_that_was_asked_for_is_drawn_as_it_is() -> None:
    (found,) = parameter_rows([row("a", 2.0, 0.5, lower=101.0, upper=105.0)], {"a": 5.0})
    middle, _, low, high, band = places(str(found.drawn))
    assert abs(low - middle - 1.0 * band / 10.0) < 0.2
    assert abs(high - middle - 5.0 * band / 10.0) < 0.2


def test_what_is_hardly_better_known_than_before_is_told_apart() -> None:
    rows = [row("wide", 1.0, 4.9), row("narrow", 1.0, 2.0), row("profiled", 1.0, 4.9, lower=90.0, upper=111.0)]
    found = parameter_rows([*rows, row("new", 1.0, 9.0)], {"wide": 5.0, "narrow": 5.0, "profiled": 5.0})
    assert {one.parameter.name: one.carried for one in found} == {
        "wide": False, "narrow": True, "profiled": True, "new": True,
    }  # fmt: skip
