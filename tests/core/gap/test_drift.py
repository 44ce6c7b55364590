"""Noise of repeats that drift: the generator here shares nothing with core, and its noise is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.noise.from_repeats import repeat_noise
from kilter_core.gap.noise.visits import average_visits
from kilter_core.observations import Observations
from tests.core.gap.simulated import campaign, katana

NOISE = 17e-6
QUICK = GapOptions(resamples=10, permutations=3, bootstraps=299, next_poses=1)


def order(layout, rng, poses=60, again=20):
    """Which pose is measured when."""
    first, few = np.arange(poses), np.arange(again)
    if layout == "at random":
        return rng.permutation(np.concatenate([first, few, few]))
    if layout == "second pass":
        return np.concatenate([first, first])
    return np.concatenate([few, first[again : poses // 2], few, first[poses // 2 :], few])


def drifting(layout, kind, size, seed):
    rng = np.random.default_rng(seed)
    pose = order(layout, rng)
    t = np.cumsum(rng.uniform(20.0, 45.0, len(pose)))
    u = (t - t[0]) / (t[-1] - t[0])
    kelvin = 22.0 + 3.0 * np.sin(8.0 * u)
    point = rng.uniform([-0.4, -0.4, 0.2], [0.4, 0.4, 0.8], (60, 3))[pose]
    way = rng.normal(size=3)
    error = NOISE * rng.normal(size=point.shape)
    error += {
        "none": lambda: np.zeros_like(point),
        "base": lambda: size * np.outer(u, way / np.linalg.norm(way)),
        "turn": lambda: size * u[:, None] * np.cross(way / np.linalg.norm(way), point) / 0.4,
        "warmth": lambda: size * (kelvin - 22.0)[:, None] / 3.0 * point / 0.5,
        "settling": lambda: size * np.outer(np.exp(-u / 0.15), way / np.linalg.norm(way)),
        "walk": lambda: size * np.cumsum(rng.normal(size=point.shape), axis=0) / np.sqrt(len(t)),
    }[kind]()
    temperature = kelvin if kind == "warmth" else np.full(len(t), 22.0)
    return Observations(q=point, position=point + error, pose_id=pose, t=t, temperature_c=temperature), error


def noise_of(rows, error):
    visits = average_visits(rows)
    mean = error[np.unique(visits.visit, return_index=True)[1]]
    return repeat_noise(error, mean, visits, visits.observations.position)


def sigma(noise):
    """Of a coordinate of a visit; a few visits that follow each other in time count as one, of two rows."""
    return float(np.sqrt(np.mean([np.trace(c) / 3 for c in noise.visit])))


def pooled(rows, error):
    pose = rows.pose_id
    mean = np.stack([np.bincount(pose, c) for c in error.T], axis=1) / np.bincount(pose)[:, None]
    return np.sqrt(np.sum((error - mean[pose]) ** 2) / 3 / (len(pose) - len(mean)))


@pytest.mark.parametrize("layout", ["at random", "second pass", "begin, middle and end"])
@pytest.mark.parametrize(
    ("kind", "size"),
    [("none", 0.0), ("base", 1e-4), ("turn", 1e-4), ("warmth", 6e-5), ("settling", 1e-4), ("walk", 6e-5)],
)
def test_noise_is_what_is_left_of_repeats_at_no_distance(layout, kind, size):
    made = [drifting(layout, kind, size, seed) for seed in range(6)]
    found = [noise_of(rows, error) for rows, error in made]
    typical = float(np.median([sigma(n) for n in found]))
    assert 0.88 * NOISE < typical < 1.12 * NOISE
    seen = np.mean([n.drift.is_significant for n in found])
    assert seen == 0.0 if kind == "none" else seen > 0.7
    if kind != "none":
        assert typical < np.median([pooled(rows, error) for rows, error in made])
        assert all(n.freedom > 9 for n in found)


def test_the_size_of_a_drift_is_that_of_a_coordinate():
    sizes, heat = [], []
    for seed in range(12):
        sizes.append(noise_of(*drifting("at random", "base", 1e-4, seed)).drift.over_campaign)
        heat.append(noise_of(*drifting("second pass", "warmth", 6e-5, seed)).drift.per_kelvin)
    assert np.median(sizes) == pytest.approx(1e-4 / np.sqrt(3.0), rel=0.2)
    rms = np.sqrt(np.mean((np.array([[0.4**2, 0.4**2, 0.0]]) / 3.0).sum() / 3.0 + 0.28 / 3.0))
    assert np.median(heat) == pytest.approx(6e-5 / 3.0 * rms / 0.5, rel=0.5)


def test_the_freedom_is_how_well_the_noise_is_known():
    """The noise found, over the true one, scatters as a chi-square of the freedom said."""
    found = [noise_of(*drifting("at random", "base", 1e-4, seed)) for seed in range(60)]
    ratio = np.array([sigma(n) ** 2 / NOISE**2 for n in found])
    said = np.sqrt(2.0 / np.median([n.freedom for n in found]))
    assert np.std(ratio) == pytest.approx(said, rel=0.35)
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.1)


def test_without_a_clock_the_order_of_the_rows_stands_in():
    rows, error = drifting("at random", "base", 1.5e-4, 3)
    noise = noise_of(replace(rows, t=None), error)
    assert noise.drift.is_significant
    assert not noise.drift.timed
    assert sigma(noise) == pytest.approx(NOISE, rel=0.2)


def test_few_repeats_far_apart_are_noise_at_most():
    rows, error = drifting("second pass", "none", 0.0, 0)
    kept = np.isin(rows.pose_id, [0, 1, 2, 3]) | (np.arange(len(rows)) < 60)
    assert noise_of(rows.select(kept), error[kept]).most
    assert not noise_of(rows, error).most


def test_spikes_among_drifting_repeats_are_no_noise():
    rows, error = drifting("at random", "base", 1e-4, 1)
    error[[5, 40]] += 2e-3
    assert sigma(noise_of(rows, error)) == pytest.approx(NOISE, rel=0.2)


def moved_in_time(rows, size):
    u = (rows.t - rows.t.min()) / np.ptp(rows.t)
    return replace(rows, position=rows.position + size * np.outer(np.sin(5.0 * u), [1.0, -0.5, 0.5]))


def test_a_hunt_says_that_repeats_drifted_and_takes_no_drift_for_noise():
    robot = katana()
    rows = moved_in_time(campaign(robot, seed=3), 2e-4)
    report = find_gap(robot, rows, replace(QUICK, effects=("backlash", "axial_compliance")), validation=0)
    assert "repeats_drift" in {w["code"] for w in report.warnings}
    assert report.noise["re_approach_mm"] < 0.03
    assert report.noise["drift"]["over_campaign_mm"] > 0.1
    assert report.verdict == "unexplained"


def test_a_noise_far_above_what_is_left_confirms_nothing():
    robot = katana()
    rows = campaign(robot, [("backlash", (1,), (2e-3,))], revisits=0, poses=100)
    options = replace(QUICK, effects=("backlash",))
    right = find_gap(robot, rows, replace(options, noise_mm=0.02))
    assert "noise_too_large" not in {w["code"] for w in right.warnings}
    assert [j.verdict for j in right.effects] == ["class_confirmed"]  # friction does it as well, whoever is asked for
    report = find_gap(robot, rows, replace(options, noise_mm=0.04))
    assert "noise_too_large" in {w["code"] for w in report.warnings}
    assert report.adequacy.p_value_low < 0.001
    assert report.adequacy.adequate is None
    assert [j.verdict for j in report.effects] == ["provisional"]


def test_repeats_that_are_copies_at_another_time_are_said():
    robot = katana()
    rows = campaign(robot, revisits=0)
    again = replace(rows, t=rows.t + 1e5)
    report = find_gap(robot, Observations.concatenate([rows, again]), QUICK)
    assert {"repeats_identical", "no_repeats"} <= {w["code"] for w in report.warnings}
    assert report.noise["absolute"] is False


def test_an_instrument_that_rounds_makes_no_copies():
    robot = katana()
    rows = campaign(robot, seed=1, noise_m=2e-5)
    coarse = replace(rows, position=np.round(rows.position / 5e-5) * 5e-5)
    codes = {w["code"] for w in find_gap(robot, coarse, QUICK).warnings}
    assert not codes & {"repeats_identical", "copied_rows"}


def test_a_clock_that_runs_backwards_is_said():
    robot = katana()
    rows = campaign(robot, seed=1)
    rows = rows.select(np.argsort(rows.t))
    half = len(rows) // 2
    back = replace(rows, t=np.where(np.arange(len(rows)) < half, rows.t, rows.t - rows.t[half]))
    report = find_gap(robot, back, QUICK)
    (warning,) = [w for w in report.warnings if w["code"] == "clock_backwards"]
    assert f"row {half + 1}" in warning["message"]
    assert report.noise["absolute"]
