"""Readings of a tracker scatter across its line of sight, an approach in all directions: what visits without repeats weigh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from kilter_core.gap.noise.from_repeats import WITHIN, add_approach_noise, of_approach, repeat_noise
from kilter_core.gap.noise.visits import average_visits
from kilter_core.observations import Observations
from tests.blind.generator import cases
from tests.blind.run import run_case

EVERY = [slice(0, 3)]


def seen_from_afar(rng, visits=120, along=4e-6, across=12e-6):
    """Lines of sight (V, 3) within a hall's angle, and covariances (V, 3, 3) of readings along and across them."""
    u = np.array([1.0, 0.0, 0.0]) + 0.3 * rng.standard_normal((visits, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    ray = u[:, :, None] * u[:, None, :]
    return u, along**2 * ray + across**2 * (np.eye(3) - ray)


def with_approach(readings, residual, used, lost, blocks):
    return readings + np.diag(of_approach(readings, residual, used, lost, blocks))


def drawn(rng, covariance):
    return np.einsum("vij,vj->vi", np.linalg.cholesky(covariance), rng.standard_normal(covariance.shape[:2]))


@pytest.mark.parametrize("approach", [4e-6, 1e-5, 3e-5])
def test_noise_has_one_variance_along_and_across_the_line_of_sight(approach):
    rng = np.random.default_rng(5)
    u, readings = seen_from_afar(rng)
    used = np.ones(len(u), dtype=bool)

    def unevenness(covariance, r):
        """Mean square along the line of sight over that across it, of residuals in units of the noise."""
        white = np.linalg.solve(np.linalg.cholesky(covariance), r[:, :, None])[:, :, 0]
        side = np.linalg.solve(np.linalg.cholesky(covariance), u[:, :, None])[:, :, 0]
        ray = np.sum(white * side, axis=1) ** 2 / np.sum(side**2, axis=1)
        return 2.0 * np.sum(ray) / np.sum(np.sum(white**2, axis=1) - ray)

    plain, shaped = [], []
    for _ in range(20):
        r = drawn(rng, readings + approach**2 * np.eye(3))
        plain.append(unevenness(readings, r))
        shaped.append(unevenness(with_approach(readings, r, used, 0.0, EVERY), r))
    expected = (16.0 + approach**2 * 1e12) / 16.0 / ((144.0 + approach**2 * 1e12) / 144.0)
    assert np.mean(plain) == pytest.approx(expected, rel=0.2)
    assert np.mean(shaped) == pytest.approx(1.0, abs=0.1)


def test_an_effect_along_the_line_of_sight_is_found_by_chance_as_often_as_it_should_be():
    """One straight line along the beam, at 1 %, on nothing but noise, whose size is that of what is left."""
    rng = np.random.default_rng(6)
    u, readings = seen_from_afar(rng, visits=80)
    used, column = np.ones(len(u), dtype=bool), u * rng.uniform(-1.0, 1.0, len(u))[:, None]

    def found(covariance, r):
        root = np.linalg.cholesky(covariance)
        y, x = (np.linalg.solve(root, v[:, :, None]).reshape(-1) for v in (r, column))
        x = x / np.linalg.norm(x)
        left = (y @ y - (x @ y) ** 2) / (len(y) - 1)
        return 2.0 * norm.sf(abs(x @ y) / np.sqrt(left)) < 0.01

    plain = shaped = 0
    for _ in range(400):
        r = drawn(rng, readings + 1e-10 * np.eye(3))
        plain += found(readings, r)
        shaped += found(with_approach(readings, r, used, 0.0, EVERY), r)
    assert plain > 20  # of 400, where 4 are expected
    assert shaped <= 10


def test_an_exact_approach_leaves_the_readings_as_they_are():
    rng = np.random.default_rng(7)
    _, readings = seen_from_afar(rng)
    used = np.ones(len(readings), dtype=bool)
    shaped = with_approach(readings, drawn(rng, readings), used, 0.0, EVERY)
    assert np.allclose(shaped, readings, rtol=0.2, atol=1e-11)


def test_of_poses_lengths_and_rotations_have_an_approach_of_their_own():
    rng = np.random.default_rng(8)
    size = np.array([1e-5, 1e-5, 4e-5, 1e-4, 4e-4, 1e-4])
    readings = np.broadcast_to(np.diag(size**2), (200, 6, 6)).copy()
    approach = np.diag(np.r_[np.full(3, 9e-10), np.zeros(3)])
    r = drawn(rng, readings + approach)
    shaped = with_approach(readings, r, np.ones(200, dtype=bool), 0.0, [slice(0, 3), slice(3, 6)])
    variance = np.diag(shaped[0])
    assert variance[0] / variance[2] == pytest.approx(10.0 / 25.0, rel=0.25)
    assert variance[3] / variance[4] == pytest.approx(1.0 / 16.0, rel=0.25)
    assert np.diag(shaped[0]) == pytest.approx(size**2 + np.diag(approach), rel=0.2)


def test_readings_without_scatter_and_visits_set_aside_are_no_obstacle():
    rng = np.random.default_rng(9)
    used = np.arange(30) > 2
    r = np.where(used[:, None], 1e-5, 1.0) * rng.standard_normal((30, 3))
    shaped = with_approach(np.zeros((30, 3, 3)), r, used, 0.5, EVERY)
    assert np.all(np.isfinite(shaped))


def test_what_readings_within_visits_show_is_kept_beside_the_noise():
    rng = np.random.default_rng(10)
    point = np.repeat(rng.uniform(1.0, 3.0, (40, 3)), 3, axis=0)
    rows = Observations(
        q=np.repeat(rng.uniform(-1.0, 1.0, (40, 2)), 3, axis=0),
        position=point + rng.normal(0.0, 1e-5, point.shape),
        pose_id=np.repeat(np.arange(40), 3),
    )
    visits = average_visits(rows)
    mean = visits.observations.position - point[::3]
    noise = repeat_noise(rows.position - point, mean, visits, visits.observations.position)
    assert noise.source == WITHIN
    assert np.array_equal(noise.readings, noise.visit)
    assert noise.over_readings == 1.0
    r = rng.normal(0.0, 1e-4, mean.shape)
    grown = add_approach_noise(noise, r, np.ones(len(r), dtype=bool), 0.0)
    assert grown.coordinate == pytest.approx(1e-4, rel=0.1)
    assert grown.over_readings == pytest.approx(1e-8 / (1e-10 / 3.0), rel=0.3)
    assert add_approach_noise(noise.even(), r, np.ones(len(r), dtype=bool), 0.0).over_readings == pytest.approx(
        grown.over_readings, rel=0.01
    )


def test_masses_stay_within_their_priors_where_the_approach_is_larger_than_the_readings_scatter():
    drawn_cases = {case.name: case for case in cases(20261129, 110)}
    for name in ("0079-one-katana-60", "0107-two-seven-30"):
        case = drawn_cases[name]
        once = replace(case.options, repeats=3, revisited=0.0, outliers=0.0, approach_um=60.0, confirmation=False)
        report = run_case(replace(case, options=once))["report"]
        assert report["noise"]["source"] == WITHIN
        away = [abs(m["value"] - m["stated"]) / m["prior_sigma"] for m in report["load_model"]]
        assert max(away) < 3.0, name  # of some twenty; they were 10 and 20 deviations from what was stated
