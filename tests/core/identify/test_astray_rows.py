"""Rows whose tool is nowhere near where their joints put it: named wherever rows are judged, and not taken for the arm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.identify import identify
from kilter_core.identify.plausibility.belonging import astray_warnings, refuse_mixed_up, renumber_warnings
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.identify.test_plausibility import ARMS, campaign


def warned(robot, rows: Observations) -> list[dict]:
    found = refuse_mixed_up(Calibration.nominal(robot), rows)
    return [one for one in found if one["code"] == "rows_astray"]


def moved(rows: Observations, places: dict[int, np.ndarray]) -> Observations:
    position = rows.position.copy()
    for row, point in places.items():
        position[row] = point
    return replace(rows, position=position)


@pytest.mark.parametrize("arm", ARMS)
def test_zeros_and_stale_positions_are_named(arm):
    robot, _, rows = campaign(arm)
    assert warned(robot, rows) == []
    zero, stale = np.zeros(3), rows.position[30] + [2.0, 0.0, 0.0]
    (said,) = warned(robot, moved(rows, {5: zero, 31: stale}))
    assert said["rows"] == [6, 32]
    assert said["message"].startswith("The tool is not where the joints put it in row 6 by ")
    assert said["off_mm"][1] == pytest.approx(2000.0, rel=0.6)


def test_many_missed_readings_hide_nothing():
    robot, _, rows = campaign("ur10", poses=90)
    wrong = [3, 8, 14, 20, 33, 41, 47, 58, 66]  # of 90
    (said,) = warned(robot, moved(rows, dict.fromkeys(wrong, np.zeros(3))))
    assert said["rows"] == [row + 1 for row in wrong]


def test_rows_of_several_set_ups_keep_their_numbers():
    robot, _, rows = campaign("ur10", poses=90)
    session = np.repeat([2, 1], 45)
    lifted = replace(rows, session=session, position=rows.position + np.where(session == 1, 3.0, 0.0)[:, None])
    begin = Calibration.nominal(robot)
    assert list(astray_warnings(begin, lifted)) == []
    stale = moved(lifted, {60: lifted.position[59]})
    (said,) = astray_warnings(begin, stale)
    assert said["rows"] == [61]
    second = np.flatnonzero(session == 1)
    (alone,) = renumber_warnings(astray_warnings(begin, stale.select(second)), second)
    assert alone == said


def test_one_row_of_zeros_does_not_become_a_verdict_on_the_arm():
    robot, _, rows = campaign("ur10", poses=90)
    found = identify(robot, moved(rows, {5: np.zeros(3)}), 0.25)
    codes = {one["code"]: one for one in found.warnings}
    assert codes["rows_astray"]["rows"] == [6]
    assert "large_residual" not in codes
    held = identify(robot, rows.select(np.arange(45)), moved(rows.select(np.arange(45, 90)), {7: np.zeros(3)}))
    (said,) = [one for one in held.warnings if one["code"] == "rows_astray"]
    assert said["rows"] == [8]
    assert said["message"].startswith("Of the validation's rows: the tool is not where")


def test_a_fit_says_that_rows_are_copies_and_takes_no_noise_from_them():
    robot, _, rows = campaign("ur10", poses=90)
    found = identify(robot, Observations.concatenate([rows, rows]))
    codes = {one["code"]: one for one in found.warnings}
    assert codes["repeats_identical"]["rows"] == list(range(91, 181))
    assert "no_repeats" in codes
    assert found.noise_source == "residuals of the fit"
    assert found.noise_m == pytest.approx(identify(robot, rows).noise_m, rel=0.05)
