"""Joint readings that are multiples of a step count as noise: campaigns in plain numpy, rounded after they were made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.identify.fit.problem import ByCovariance, SharedErrors
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.repeats import reading_steps
from tests.core.gap.time_twins import BASE, DH, NOISE_M, TOOL, robot, tool_points

QUICK = GapOptions(
    resamples=2, permutations=2, bootstraps=199, next_poses=0,
    effects=("second_harmonic", "eccentricity", "backlash", "drift", "base_step"),
)  # fmt: skip
CURVE = (6e-4, -5e-4)  # of joint 3
HINGES = [False] * 6


def campaign(seed: int, step_deg: float, amounts: tuple[float, float] = CURVE) -> Observations:
    """Sixty poses, twenty of them three times, and the readings rounded to a step."""
    rng = np.random.default_rng([seed, 31])
    q = rng.uniform([-2.8, -2.2, -2.0, -2.8, -2.5, -2.8], [2.8, -0.4, 2.0, 2.8, 2.5, 2.8], (60, 6))
    pose = rng.permutation(np.concatenate([np.arange(60), np.tile(np.arange(20), 2)]))
    dh = DH + rng.normal(size=DH.shape) * np.array([1e-3, 3e-4, 3e-4, 1e-3])
    wrong = np.zeros_like(q)
    wrong[:, 2] = amounts[0] * np.sin(2.0 * q[:, 2]) + amounts[1] * np.cos(2.0 * q[:, 2])
    points = tool_points(q + wrong, dh, np.tile(TOOL, (60, 1))) + BASE
    step = np.radians(step_deg)
    read = np.round(q / step) * step if step_deg else q
    return Observations(
        q=read[pose],
        position=points[pose] + NOISE_M * rng.normal(size=(100, 3)),
        pose_id=pose,
        t=30.0 * np.arange(100.0),
    )


def test_the_step_of_readings_is_found_in_degrees_radians_ticks_and_mm():
    q = np.random.default_rng(1).uniform(-2.0, 2.0, (40, 6))
    for step in (np.radians(0.05), np.radians(0.01), 1e-4, 2.0 * np.pi / 2**13):
        np.testing.assert_allclose(reading_steps(np.round(q / step) * step, HINGES), step)
        np.testing.assert_allclose(reading_steps(np.round(q / step) * step + 0.0123, HINGES), step)  # another zero
    tick = np.round(np.degrees(np.round(q / (2.0 * np.pi / 2**13)) * 2.0 * np.pi / 2**13), 4)
    np.testing.assert_allclose(reading_steps(np.radians(tick), HINGES), 2.0 * np.pi / 2**13)  # in a file of 4 decimals
    assert not np.any(reading_steps(q, HINGES))
    slide = np.round(q[:, :1], 5)
    assert reading_steps(np.hstack([slide, q[:, 1:]]), [True, *HINGES[1:]]).tolist() == pytest.approx(
        [1e-5, 0, 0, 0, 0, 0]
    )


@pytest.mark.parametrize("step_deg", [0.03, 0.036, 0.015])
def test_a_step_that_is_a_multiple_of_a_known_one_is_found(step_deg: float) -> None:
    """Encoders of 10 000 lines count 0.036 degrees: they were taken for thousandths that round nothing."""
    q = np.random.default_rng(2).uniform(-2.0, 2.0, (40, len(HINGES)))
    step = np.radians(step_deg)
    np.testing.assert_allclose(reading_steps(np.round(q / step) * step, HINGES), step)


def test_servos_of_4096_ticks_step_as_lerobot_converts_them():
    """In degrees from the middle of a range, which may lie between two ticks, as float32: 4095 ticks to a full circle."""
    ticks = np.random.default_rng(2).integers(700, 3400, (40, 6))
    degrees = ((ticks - 2051.5) * 360.0 / 4095.0).astype(np.float32)
    np.testing.assert_allclose(reading_steps(np.radians(degrees.astype(np.float64)), HINGES), 2.0 * np.pi / 4095.0)


def test_few_levels_tell_no_step_of_their_own():
    q = np.round(np.random.default_rng(1).uniform(-2.0, 2.0, (40, 2)) / 1e-4) * 1e-4
    q[:, 1] = np.tile([0.0, 0.5, 1.0, 1.5], 10)
    np.testing.assert_allclose(reading_steps(q, [False, False]), 1e-4)
    assert not np.any(reading_steps(q[:, 1:], [False]))


def test_shared_errors_whiten_as_the_whole_covariance_does():
    rng = np.random.default_rng(2)
    by = np.linalg.inv(np.linalg.cholesky(np.eye(3) + 0.1 * np.ones((3, 3))))[None].repeat(4, axis=0)
    S = rng.normal(size=(6, 2))
    shared = SharedErrors.from_blocks([(np.array([0, 1, 2, 6, 7, 8]), S)])
    whitening = ByCovariance(by, np.ones(4, dtype=bool), shared)
    rows = np.eye(12).reshape(4, 3, 12)
    white = whitening.columns(rows.copy())
    alone = ByCovariance(by, np.ones(4, dtype=bool)).columns(rows.copy())
    whole = np.zeros((12, 2))
    whole[[0, 1, 2, 6, 7, 8]] = S
    back = np.linalg.inv(alone)
    covariance = back @ (np.eye(12) + whole @ whole.T) @ back.T
    np.testing.assert_allclose(white @ covariance @ white.T, np.eye(12), atol=1e-12)
    r = rng.normal(size=(4, 3))
    np.testing.assert_allclose(whitening.residual(r).reshape(-1), white @ r.reshape(-1), atol=1e-12)
    np.testing.assert_allclose(whitening.back(whitening.residual(r).reshape(-1)), r, atol=1e-12)


def test_rounded_readings_are_said_and_weighed():
    report = find_gap(robot(), campaign(1, 0.05), QUICK)
    (warning,) = [w for w in report.warnings if w["code"] == "rounded_readings"]
    assert "multiples of 0.05 deg (joints 1, 2, 3, 4, 5, 6)" in warning["message"]
    assert report.noise["rounding_steps"] == pytest.approx([0.05] * 6)
    assert 0.1 < report.noise["rounding_mm"] < 0.4
    assert report.gap["noise_mm"] == pytest.approx(0.03, rel=0.3)  # what repeats show stays theirs
    assert report.gap["noise_rms_mm"] == pytest.approx(
        np.sqrt(3.0) * np.hypot(0.03, report.noise["rounding_mm"]), rel=0.2
    )


def test_intervals_and_chi_square_hold_with_rounding():
    """Twelve amplitudes, of which at most two may lie outside their 95 % interval (98 % of such tests)."""
    inside, judged = 0, []
    for seed in range(6):
        report = find_gap(robot(), campaign(seed, 0.05), QUICK)
        assert {j.evidence.candidate.label for j in report.effects} <= {"second_harmonic j3"}, seed
        assert report.adequacy.adequate, seed
        assert report.unseen is not None
        judged.append(report.unseen.p_value)
        for effect in report.effects:
            inside += sum(a.low <= v <= a.high for a, v in zip(effect.evidence.amplitudes, CURVE, strict=True))
    assert inside >= 10
    assert min(judged) > 0.01 / 6


def test_nothing_is_named_where_only_readings_are_rounded():
    for seed in range(10, 13):
        report = find_gap(robot(), campaign(seed, 0.05, (0.0, 0.0)), QUICK)
        assert not report.effects, seed
        assert report.verdict == "no_gap", seed


def test_unrounded_readings_and_commands_that_were_obeyed_are_weighed_as_before():
    plain = campaign(1, 0.0)
    settings = prepare_data(Calibration.nominal(robot()), plain, QUICK).problem.settings
    assert (settings.rounding, settings.shared) == (None, None)
    assert np.array_equal(settings.whitener, settings.noise.whiteners())
    # Poses typed in with whole degrees, where the arm then was: a rounding of 1 deg would leave 5 mm.
    typed = campaign(1, 0.0)
    whole = np.radians(np.round(np.degrees(typed.q)))
    points = tool_points(whole, DH, np.tile(TOOL, (100, 1))) + BASE
    rng = np.random.default_rng(4)
    obeyed = replace(typed, q=whole, position=points + NOISE_M * rng.normal(size=(100, 3)))
    settings = prepare_data(Calibration.nominal(robot()), obeyed, QUICK).problem.settings
    assert settings.rounding is None
