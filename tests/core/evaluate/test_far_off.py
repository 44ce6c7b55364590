"""Rows far off what a calibration expects are named, and no others."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.evaluate import evaluate
from kilter_core.evaluate.prediction import far_off
from kilter_core.identify import identify
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.observations import Observations
from tests.core.campaigns import joints, measured
from tests.core.truth import some_pose, ur10, with_hidden_errors

NOISE = 5e-5
U95 = np.full((40, 3), 1.96)


def test_three_wrong_rows_are_named_with_how_far_off_they_are() -> None:
    rng = np.random.default_rng(5)
    true = with_hidden_errors(ur10(base=some_pose(rng, 2.0)), rng)
    robot = robot_from_document(ur10().document())
    found = identify(robot, measured(true, joints(true, 100, rng), rng, NOISE))
    known = Predictive.from_document(found.predictive.to_document(), found.to_document())
    seen = measured(true, joints(true, 30, rng), rng, NOISE)
    assert seen.position is not None
    good = evaluate(found.calibration, seen, (), known)
    assert not [one for one in good["warnings"] if one["code"] == "rows_far_off"]
    position, q = seen.position.copy(), seen.q.copy()
    position[4] += [0.0, 1.5e-3, 0.0]
    position[17] += [8e-4, 0.0, 0.0]
    q[22, 0] += np.radians(1.0)  # mistyped
    wrong = evaluate(found.calibration, Observations(q, position=position), (), known)
    (said,) = [one for one in wrong["warnings"] if one["code"] == "rows_far_off"]
    assert said["rows"] == [23, 5, 18]
    assert said["off_mm"][1:] == pytest.approx([1.5, 0.8], abs=0.25)
    sigma = dict(zip(said["rows"], said["sigmas"], strict=True))
    half = wrong["rows"]["u95_y_mm"][4] / 1.96
    assert sigma[5] == pytest.approx(abs(wrong["rows"]["dy_mm"][4]) / half)
    assert said["message"].startswith("Rows 23 (")
    assert f"5 ({said['off_mm'][1]:.3g} mm, {sigma[5]:.2g} sigma)" in said["message"]


def test_rows_like_the_others_are_hardly_ever_named() -> None:
    """As expected, all four times as far off, and where the three coordinates are one number."""
    rng = np.random.default_rng(6)
    named = dict.fromkeys(("free", "one", "far", "far and one"), 0)
    for _ in range(3000):
        free, one = rng.standard_normal((40, 3)), np.tile(rng.standard_normal((40, 1)), 3)
        for name, error in zip(named, (free, one, 4.0 * free, 4.0 * one), strict=True):
            named[name] += len(far_off(error, U95)[0]) > 0
    assert max(named["free"], named["one"], named["far"]) <= 9  # 3 are meant; more come with 0.1 %
    assert named["far and one"] <= 45  # the median of 40 numbers is off by a fifth itself


def test_rows_without_a_marker_are_passed_over() -> None:
    error = np.random.default_rng(7).standard_normal((40, 3))
    error[3] = np.nan
    error[9, 1] = 30.0
    rows, sigmas = far_off(error, U95)
    assert rows.tolist() == [9]
    assert sigmas == pytest.approx([30.0])
    assert len(far_off(np.full((4, 3), np.nan), U95[:4])[0]) == 0
