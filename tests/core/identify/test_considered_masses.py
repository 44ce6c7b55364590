"""Masses beside signs of a load: values as if they were exact, in one fit, and intervals that hold what they do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.identify import Identification, IdentifyOptions, identify
from tests.core.identify.test_stated_noise import EXACT, NAMED, TRUTH, apart, misstated, soft_elbow, stated
from tests.core.off_zero import OffZero

CONSIDERED = IdentifyOptions(effects=NAMED)
MISSED = 1.96  # sigmas


@pytest.fixture(scope="module")
def twin() -> OffZero:
    return soft_elbow(**TRUTH)


@pytest.fixture(scope="module")
def wrong(twin: OffZero) -> list[Identification]:
    return [identify(misstated(twin, seed), stated(twin, seed), options=CONSIDERED) for seed in range(2, 7)]


def test_intervals_hold_the_truth_although_the_masses_are_wrong(wrong: list[Identification]) -> None:
    inside = np.abs([apart(found) for found in wrong]) < MISSED
    assert inside.size == 45
    assert inside.sum() >= 44  # the third has an amplitude that wrong signs put near zero


def test_values_are_those_of_exact_masses_and_sigmas_are_wider(twin: OffZero) -> None:
    rows = stated(twin, 1)
    found, exact = (identify(twin.robot, rows, options=options) for options in (CONSIDERED, EXACT))
    np.testing.assert_array_equal(found.fit.values, exact.fit.values)
    assert np.all(found.fit.sigma >= exact.fit.sigma * (1.0 - 1e-9))
    named = [k for k, name in enumerate(found.free_names) if name.startswith(("clearance", "backlash_load"))]
    assert np.all(found.fit.sigma[named] > 1.5 * exact.fit.sigma[named])
    assert np.abs(apart(found)).max() < MISSED
    np.testing.assert_array_equal(found.predictive.covariance, exact.predictive.covariance)


def test_better_masses_leave_the_values_better_known(twin: OffZero) -> None:
    rows = stated(twin, 2)
    weighed = replace(CONSIDERED, mass_sigma_percent=0.1, com_sigma_mm=0.1)
    loose, tight, exact = (
        identify(twin.robot, rows, options=options).fit.sigma[:] for options in (CONSIDERED, weighed, EXACT)
    )
    assert np.all(tight <= loose)
    assert np.median(tight / exact) < 1.2


def test_the_result_says_so(wrong: list[Identification], twin: OffZero) -> None:
    said = wrong[0].to_document()["masses"]
    assert (said["carried"], said["considered"]) == (False, True)
    assert "10 %" in said["sentence"]
    assert "clearance_tilt, backlash_load" in said["sentence"]
    asked = identify(twin.robot, stated(twin, 1), options=EXACT).to_document()["masses"]
    assert (asked["carried"], asked["considered"]) == (False, False)
