"""Derivatives of many rows are made part by part: the same numbers, and little memory besides what is kept."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from kilter_core.gap.options import GapOptions
from kilter_core.gap.search.linear.linearized import linearise_problem
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.gap.search.sources import tool_source
from kilter_core.model import Calibration
from tests.core.gap.simulated import campaign, katana

# Linear in the loads: slopes of others are differences over a width that follows the rows at hand.
OPTIONS = GapOptions(effects=("eccentricity", "axial_compliance", "link_bending", "settling"))
MB = 2**20


def prepared(measured: str, options: GapOptions = OPTIONS):
    robot = katana()
    rows = campaign(robot, [("axial_compliance", (1,), (3e-5,))], seed=5, measured=measured)
    return prepare_data(Calibration.nominal(robot), rows, options).problem


@pytest.mark.parametrize("measured", ["position", "pose", "markers"])
def test_parts_are_the_whole(measured, monkeypatch):
    problem = prepared(measured)
    tool = problem.settings.source
    values = problem.values.copy()
    values[len(values) - tool.n_library :] = 1e-5
    values[tool.free[tool.soft]] += 0.3 * tool.prior_sigma[tool.soft]
    columns = [3, 0, 5]
    whole = tool.linear(values), tool.linear(values, None, columns)
    monkeypatch.setattr(tool_source, "MOST_NUMBERS", 40 * (len(tool.free) + 3))
    assert len(tool._row_slices(len(tool.free) + 3)) == 3
    for one, other in zip(whole, (tool.linear(values), tool.linear(values, None, columns)), strict=True):
        for name in ("r", "G", "W"):
            a, b = getattr(one, name), getattr(other, name)
            np.testing.assert_allclose(b, a, rtol=1e-6, atol=1e-8 * np.nanmax(np.abs(a)))


def test_a_world_of_many_rows_takes_little_besides_itself():
    """Some arrays of the whole size are passed on the way to a world; they were a dozen, beside two that it kept."""
    problem = prepared("position", GapOptions())
    tool = problem.settings.source
    many = np.tile(np.arange(len(tool.batch)), 40)
    settings = problem.settings
    wide = tool.with_measurement(type(tool.measurement)(tool.measurement.observations.select(many)))
    noise = type(settings.noise)(**{**vars(settings.noise), "visit": settings.noise.visit[many]})
    large = type(settings)(wide, noise, settings.used[many], np.arange(len(many)))
    assert wide.batch.slopes.component_slopes("axial", 0).size  # loads are made once, and are not counted
    tracemalloc.start()
    try:
        made = linearise_problem(large, problem.values)
        kept, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    size = made.W_raw.nbytes
    assert size > 20 * MB
    assert kept < 1.8 * size
    assert peak < 5.0 * size
