"""Predictive intervals on arms whose truth is a Pinocchio model: of the tool, and of what an instrument will read."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.evaluate import evaluate
from kilter_core.identify import Identification, IdentifyOptions, identify
from kilter_core.identify.uncertainty.predictive import Predictive, acting, predictive
from kilter_core.measurement import Measurement
from kilter_core.observations import Observations
from tests.core.campaigns import joints, measured
from tests.core.identify.test_identify import somewhere
from tests.core.truth import Arm

NOISE = 2e-5
Floats = NDArray[np.float64]


@cache
def found(seed: int, repeats: bool = True, see: str = "position") -> tuple[Identification, Arm, Floats, Observations]:
    """An identification of 60 poses, 20 of them visited twice; joints and rows of 40 others."""
    robot, true, rng = somewhere(seed)
    q = joints(true, 60, rng)
    order = np.concatenate([np.arange(60), rng.choice(60, 20, replace=False)]) if repeats else np.arange(60)
    rows = measured(true, q[order], rng, NOISE, see)
    new = joints(true, 40, rng)
    return identify(robot, rows), true, new, measured(true, new, rng, NOISE, see)


@pytest.mark.parametrize("repeats", [True, False])
def test_the_tool_is_within_its_interval(repeats: bool) -> None:
    inside = []
    for seed in range(20):
        result, true, q, _ = found(seed, repeats)
        u95 = result.predictive.of_the_tool(result.calibration, Observations(q))
        inside.append(np.abs(result.calibration.predict(Observations(q)).position - true.poses(q)[0]) <= u95)
    assert 0.94 < np.mean(inside) < 0.985  # errors that the noise may hide are counted: 0.96 without


@pytest.mark.parametrize("refit", [(), ("base", "tool")])
@pytest.mark.parametrize("repeats", [True, False])
def test_what_is_measured_next_is_within_its_interval(repeats: bool, refit: tuple[str, ...]) -> None:
    inside = []
    for seed in range(20):
        result, _, _, held = found(seed, repeats)
        inside.append(evaluate(result.calibration, held, list(refit), result.predictive)["within_u95"])
    assert np.mean(inside) == pytest.approx(0.95, abs=0.025)


def test_noise_is_told_from_what_the_model_misses_without_repeats() -> None:
    with_repeats, without = found(0)[0].predictive, found(0, repeats=False)[0].predictive
    for known in (with_repeats, without):
        assert known.inadequacy < 0.4 * NOISE
        assert known.noise == pytest.approx(NOISE, rel=0.3)


@pytest.mark.parametrize("sag", [3e-5, 3e-4])
@pytest.mark.parametrize("repeats", [0, 40])
def test_where_an_effect_is_missing_the_tool_is_within_its_interval(repeats: int, sag: float) -> None:
    inside = []
    for seed in range(4):
        robot, true, rng = somewhere(seed)
        q, new = joints(true, 120, rng), joints(true, 200, rng)
        q = np.vstack([q, q[:repeats]])
        rows = replace(measured(true, sagging(q, sag), rng, NOISE), q=q)
        result = identify(robot, rows)
        u95 = result.predictive.of_the_tool(result.calibration, Observations(new))
        away = result.calibration.predict(Observations(new)).position - true.poses(sagging(new, sag))[0]
        inside.append(np.abs(away) <= u95)
    assert np.mean(inside) > 0.935


def sagging(q: Floats, amplitude: float) -> Floats:
    """Joints (N, 6) rad whose second and third give way to a load that hangs on the forearm."""
    far = 0.6 * np.cos(q[:, 1] + q[:, 2])
    out = q.copy()
    out[:, 1] += amplitude * (np.cos(q[:, 1]) + far)
    out[:, 2] += amplitude * far
    return out


def test_what_nothing_tells_apart_counts_as_the_model_s() -> None:
    result = found(0, repeats=False)[0]
    few = predictive(result.fit, result.repeats, None, None)
    assert (few.inadequacy, few.noise) == (pytest.approx(NOISE, rel=0.3), 0.0)


def test_drift_over_the_rows_is_no_noise() -> None:
    robot, true, rng = somewhere(6)
    rows = measured(true, joints(true, 120, rng), rng, NOISE)
    assert rows.position is not None
    drift = 5e-5 * np.linspace(-1.0, 1.0, 120)[:, None] * np.array([1.0, -0.5, 0.5])
    drifted = identify(robot, replace(rows, position=rows.position + drift)).predictive
    assert drifted.inadequacy > NOISE


def test_what_the_model_misses_widens_the_intervals() -> None:
    robot, true, rng = somewhere(2)
    q = joints(true, 100, rng)
    q = np.vstack([q, q[:30]])
    rows = measured(true, q, rng, NOISE)
    assert rows.position is not None
    missed = 1e-4 * np.stack([np.sin(2 * q[:, 1]), np.cos(3 * q[:, 2]), np.sin(2 * q[:, 3] + q[:, 1])], axis=1)
    spoilt = identify(robot, replace(rows, position=rows.position + missed), None, IdentifyOptions())
    assert spoilt.predictive.noise == pytest.approx(NOISE, rel=0.2)
    assert spoilt.predictive.inadequacy == pytest.approx(7e-5, rel=0.25)


def test_poses_far_from_those_measured_are_less_certain() -> None:
    robot, true, rng = somewhere(3)
    q = 0.3 * joints(true, 80, rng)
    result = identify(robot, measured(true, q, rng, NOISE))
    known = replace(result.predictive, inadequacy=0.0)
    near, far = (known.of_the_tool(result.calibration, Observations(k * q)) for k in (1.0, 3.0))
    assert np.median(far) > 2.0 * np.median(near)


def test_the_intervals_turn_with_the_axes_they_are_told_along() -> None:
    result, _, q, _ = found(4)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    plain = result.predictive.of_the_tool(result.calibration, Observations(q))
    turned = result.predictive.of_the_tool(result.calibration, Observations(q), turn)
    np.testing.assert_allclose(turned, plain[:, [1, 0, 2]], rtol=1e-9)


def test_a_document_keeps_it_and_an_older_one_says_what_its_metrics_say() -> None:
    result = found(5)[0]
    again = Predictive.from_document(result.predictive.to_document())
    assert again is not None
    np.testing.assert_array_equal(again.covariance, result.predictive.covariance)
    assert (again.inadequacy, again.noise) == (result.predictive.inadequacy, result.predictive.noise)
    assert Predictive.from_document({}) is None
    old = {k: v for k, v in result.predictive.to_document().items() if k not in ("inadequacy_m", "noise_m")}
    metrics = {"train": {"identified": {"rms_mm": 0.05}}}
    read = Predictive.from_document(old, {"metrics": metrics, "noise_mm": 0.02, "noise_source": "repeats"})
    assert read is not None
    assert read.inadequacy == pytest.approx(np.sqrt(5e-5**2 / 3 - 2e-5**2))
    assert read.noise == pytest.approx(2e-5)


@pytest.mark.parametrize("see", ["pose", "markers"])
def test_poses_and_markers_have_intervals_too(see: str) -> None:
    inside = []
    for seed in range(4):
        result, _, _, held = found(seed, see=see)
        u95 = result.predictive.of_measured(
            result.calibration, Measurement.from_observations(held, result.calibration.marker_points)
        )
        assert u95.shape == (40, 3)
        inside.append(evaluate(result.calibration, held, (), result.predictive)["within_u95"])
    assert 0.9 < np.mean(inside) <= 1.0


def test_effects_that_the_rows_cannot_feel_are_left_out() -> None:
    result, _, q, _ = found(0)
    assert acting(result.calibration, Observations(q)) is result.calibration
