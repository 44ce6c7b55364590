"""Budgets and decisions: on arms whose truth is a Pinocchio model, on a real campaign, and by hand."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from kilter_core.errors import OptionError
from kilter_core.evaluate import errors_by_row
from kilter_core.evaluate.error_budget import Budget, PermissibleError, judge
from kilter_core.identify import Identification, IdentifyOptions, identify
from kilter_core.identify.holdout import split
from kilter_core.identify.options import FRAME_NAMES
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.measurement import Measurement
from kilter_core.observations import Observations
from kilter_core.types import QUANTILE
from tests.core.campaigns import joints, measured
from tests.core.identify.test_identify import somewhere
from tests.core.real import real_campaign

MPE = PermissibleError(15e-6, 6e-6)
NOISE = 5e-5  # how an arm returns, m


def seen(rows: Observations, rng: np.random.Generator, scale: float) -> Observations:
    """Rows as a tracker gives them whose errors are within its permissible error: a scale of its own, and noise."""
    assert rows.position is not None
    middle = rows.position.mean(axis=0)
    noise = rng.uniform(-1.0, 1.0, rows.position.shape) * MPE.fixed / 2.0
    return replace(rows, position=middle + (rows.position - middle) * (1.0 + scale) + noise)


@cache
def found(seed: int) -> tuple[Identification, Observations]:
    """A version of 60 poses, 20 of them visited twice, and the rows of 40 poses that it was not fitted to."""
    robot, true, rng = somewhere(seed)
    scale = rng.uniform(-1.0, 1.0) * MPE.per_length
    q = joints(true, 60, rng)
    order = np.concatenate([np.arange(60), rng.choice(60, 20, replace=False)])
    rows = seen(measured(true, q[order], rng, NOISE), rng, scale)
    held = seen(measured(true, joints(true, 40, rng), rng, NOISE), rng, scale)
    return identify(robot, rows), held


def budget(result: Identification, rows: Observations, **given: Any) -> tuple[Budget, np.ndarray]:
    measurement = Measurement.from_observations(rows, result.calibration.marker_points)
    made = Budget.from_measurement(result.calibration, result.predictive, measurement, **given)
    assert made is not None
    return made, errors_by_row(result.calibration, measurement).error


def test_new_measurements_are_within_the_expanded_uncertainty() -> None:
    inside = []
    for seed in range(16):
        made, error = budget(*found(seed), instrument=MPE)
        inside.append(np.abs(error) <= 2.0 * made.prediction_uncertainty)
    assert 0.94 < np.mean(inside) < 0.975


def test_held_out_rows_of_a_real_arm_are_within_it(shared_data: Any) -> None:
    robot, rows = real_campaign(shared_data, "fanuc")
    inside = []
    for seed in range(4):  # the largest error of one split is not that of another
        train, held = split(rows, 0.3, seed)
        result = identify(robot, rows.select(train), None, IdentifyOptions(seed=seed))
        made, error = budget(result, rows.select(held), instrument=MPE)
        inside.append((np.abs(error) <= 2.0 * made.prediction_uncertainty)[~np.isnan(error)])
    assert 0.94 <= np.mean(np.concatenate(inside)) <= 0.97


def test_contributions_add_to_what_the_version_says_of_itself() -> None:
    result, rows = found(0)
    measurement = Measurement.from_observations(rows, result.calibration.marker_points)
    made, _ = budget(result, rows)
    u95 = result.predictive.of_measured(result.calibration, measurement)
    np.testing.assert_allclose(QUANTILE * made.prediction_uncertainty, u95, rtol=1e-6)
    assert set(made.variances) == {"repeatability", "registration", "model", "left_over"}
    told = made.to_document()
    assert told["not_assessed"] == ["instrument", "temperature"]
    assert sum(one["share"] for one in told["contributions"]) == pytest.approx(1.0)
    assert told["expanded_mm"] == pytest.approx(2.0 * told["standard_mm"])
    assert told["measured_expanded_mm"] < told["expanded_mm"]
    # A base can take up what the first link does: apart they are known to nothing, and together well.
    assert told["correlations"][0]["coefficient"] < -0.9


def test_what_is_known_of_frames_alone_is_registration() -> None:
    result, rows = found(0)
    frames = tuple(f"base_{k}" for k in FRAME_NAMES)
    sigma = np.array([1e-4, 1e-4, 1e-4, 0.0, 0.0, 0.0])
    known = Predictive(frames, np.diag(sigma**2), 0.0, 0.0)
    measurement = Measurement.from_observations(rows, result.calibration.marker_points)
    made = Budget.from_measurement(result.calibration, known, measurement)
    assert made is not None
    np.testing.assert_allclose(made.variances["registration"], 1e-8, rtol=1e-6)
    np.testing.assert_allclose(made.variances["model"], 0.0, atol=1e-20)


def test_a_correlated_frame_leaves_what_the_others_do_not_tell() -> None:
    result, rows = found(0)
    name = result.calibration.names[6]
    sigma, r = 1e-4, 0.8
    known = Predictive(("base_x", name), sigma**2 * np.array([[1.0, r], [r, 1.0]]), 0.0, 0.0)
    made = Budget.from_measurement(
        result.calibration, known, Measurement.from_observations(rows, result.calibration.marker_points)
    )
    assert made is not None
    expected = sigma**2 * (1.0 - r**2)  # of a pair: what the other does not explain
    np.testing.assert_allclose(made.variances["registration"].sum(axis=1), expected, rtol=1e-6)


def test_the_permissible_error_is_a_rectangle() -> None:
    lengths = np.array([0.0, 1.0, 2.5])
    np.testing.assert_allclose(MPE.half_width(lengths), [15e-6, 21e-6, 30e-6])
    np.testing.assert_allclose(MPE.standard(lengths), np.array([15e-6, 21e-6, 30e-6]) / np.sqrt(3.0))
    result, rows = found(0)
    made, _ = budget(result, rows, instrument=MPE)
    assert rows.position is not None
    far = np.linalg.norm(rows.position - rows.position.mean(axis=0), axis=1)
    expected = ((15e-6 + 6e-6 * far) / np.sqrt(3.0)) ** 2
    np.testing.assert_allclose(made.variances["instrument"], np.tile(expected[:, None], 3))
    (told,) = [one for one in made.to_document()["contributions"] if one["source"] == "instrument"]
    assert (told["type"], told["distribution"]) == ("B", "rectangular")
    assert told["half_width_mm"] == pytest.approx(told["standard_mm"] * np.sqrt(3.0))


def test_a_temperature_that_varied_counts_and_one_that_did_not_is_nothing() -> None:
    result, rows = found(0)
    warm = replace(rows, temperature_c=np.linspace(20.0, 24.0, len(rows)))
    made, _ = budget(result, warm)
    position = result.calibration.predict(rows).position
    reach = np.linalg.norm(position - result.calibration.model.T_base[:3, 3], axis=1)
    np.testing.assert_allclose(made.variances["temperature"][:, 0], (23e-6 * 2.0 * reach) ** 2 / 3.0)
    same, _ = budget(result, replace(rows, temperature_c=np.full(len(rows), 21.0)))
    assert not same.variances["temperature"].any()
    assert same.to_document()["not_assessed"] == ["instrument"]


def test_frames_fitted_to_the_rows_are_known_by_them() -> None:
    result, rows = found(0)
    made, _ = budget(result, rows, refit=["base"])
    fewer, _ = budget(result, rows.select(np.arange(12)), refit=["base"])
    assert fewer.variances["registration"].mean() > 2.0 * made.variances["registration"].mean()


def test_conformity_is_proved_within_the_guard_band_only() -> None:
    errors, expanded = np.array([0.1e-3, 0.25e-3]), np.array([0.02e-3, 0.04e-3])
    for tolerance, decision in (
        (0.29e-3, "accepted"),
        (0.289e-3, "not_proved"),
        (0.21e-3, "not_proved"),
        (0.2e-3, "rejected"),
    ):
        made = judge(errors, expanded, tolerance + 1e-12)
        assert (made.decision, made.row) == (decision, 1), tolerance
        assert made.to_document()["provable_mm"] == pytest.approx(0.29)
    # The row that rejects is the one beyond by its own guard band, not the one with the widest.
    made = judge(np.array([0.30e-3, 0.28e-3]), np.array([0.15e-3, 0.01e-3]), 0.2e-3)
    assert (made.decision, made.row) == ("rejected", 1)
    for wrong in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(OptionError, match="tolerance"):
            judge(errors, expanded, wrong)
    with pytest.raises(OptionError, match="no errors"):
        judge(np.zeros(0), np.zeros(0), 1e-3)


def test_an_arm_just_beyond_its_tolerance_is_seldom_accepted() -> None:
    rng = np.random.default_rng(0)
    u, tolerance = 1e-5, 3e-4
    read = tolerance * 1.001 + rng.normal(0.0, u, 4000)
    accepted = [judge(np.array([one]), np.array([2.0 * u]), tolerance).decision == "accepted" for one in read]
    within = tolerance * 0.999 + rng.normal(0.0, u, 4000)
    rejected = [judge(np.array([one]), np.array([2.0 * u]), tolerance).decision == "rejected" for one in within]
    assert np.mean(accepted) < 0.03
    assert np.mean(rejected) < 0.03
