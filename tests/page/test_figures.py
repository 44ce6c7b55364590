"""Figures: what is written along an axis can be read."""

from __future__ import annotations

import re
from itertools import pairwise

from kilter_service.page.figures.plot import LEFT, RIGHT, Plot
from kilter_service.page.figures.scale import around, named


def drawn(names: list[str], width: float = 760.0) -> str:
    plot = Plot("errors", named("parameter", names), around("mm", [1.0], zero=True), width)
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
