"""Mean and spread of a type: against closed forms, against a likelihood maximised by another way, and shrunk."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from kilter_core.identify.fleet_prior import population

Floats = NDArray[np.float64]
ONE = np.zeros(1, dtype=np.int64)


def restricted(between: float, values: Floats, within: Floats) -> float:
    """Minus twice the restricted likelihood of one parameter (Harville 1977), written out."""
    weight = 1.0 / (within + between)
    mean = np.sum(weight * values) / np.sum(weight)
    return float(-np.sum(np.log(weight)) + np.log(np.sum(weight)) + np.sum(weight * (values - mean) ** 2))


def test_of_fits_alike_the_spread_is_what_their_scatter_has_beyond_their_doubt() -> None:
    values = np.random.default_rng(1).normal(0.3, 0.2, (9, 1))
    found = population(values, np.full((9, 1, 1), 0.01), ONE, strength=0.0)
    assert found.between[0, 0] == pytest.approx(np.var(values, ddof=1) - 0.01, rel=1e-3)
    assert found.mean[0] == pytest.approx(values.mean())
    assert found.mean_covariance[0, 0] == pytest.approx((found.between[0, 0] + 0.01) / 9)


def test_of_fits_unlike_it_maximises_the_restricted_likelihood() -> None:
    rng = np.random.default_rng(2)
    within = rng.uniform(0.002, 0.05, 14)
    values = rng.normal(0.0, 0.2, 14) + rng.normal(0.0, np.sqrt(within))
    best = minimize_scalar(
        restricted, bounds=(1e-6, 1.0), args=(values, within), method="bounded", options={"xatol": 1e-9}
    )
    found = population(values[:, None], within[:, None, None], ONE, strength=0.0)
    assert found.between[0, 0] == pytest.approx(best.x, rel=0.01)


def test_two_parameters_that_go_together_are_seen_to() -> None:
    rng = np.random.default_rng(3)
    truth = np.array([[0.04, 0.03], [0.03, 0.04]])
    values = rng.multivariate_normal([0.1, -0.2], truth, 400)
    within = np.tile(np.diag([0.01, 0.02]), (400, 1, 1))
    values = values + rng.normal(0.0, 1.0, (400, 2)) * np.sqrt([0.01, 0.02])
    found = population(values, within, np.zeros(2, dtype=np.int64), strength=0.0)
    np.testing.assert_allclose(found.between, truth, atol=0.008)


def test_a_few_arms_do_not_say_that_parameters_go_together() -> None:
    values = np.random.default_rng(4).normal(0.0, 0.1, (5, 12))
    within = np.tile(np.eye(12) * 1e-4, (5, 1, 1))
    groups = np.repeat([0, 1], 6)
    plain, shrunk = (population(values, within, groups, strength).between for strength in (0.0, None))
    assert np.linalg.matrix_rank(plain, tol=1e-3) <= 4
    assert np.linalg.cond(shrunk) < 100.0
    away = [np.sqrt(np.mean((C - np.eye(12) * 0.01) ** 2)) for C in (plain, shrunk)]
    assert away[1] < 0.6 * away[0]


def test_what_no_fit_tells_spreads_as_what_has_its_unit() -> None:
    rng = np.random.default_rng(5)
    values = rng.normal(0.0, 0.1, (8, 6))
    values[:, 5] = 0.0  # held where it was
    within = np.tile(np.diag([1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1.0]), (8, 1, 1))
    found = population(values, within, np.zeros(6, dtype=np.int64))
    others = float(np.mean(np.diag(found.between)[:5]))
    assert 0.3 * others < found.between[5, 5] < 3.0 * others
    assert found.mean_covariance[5, 5] > 0.1  # and its mean is as good as unknown
