"""Robust weights on lines and planes whose truth is known: written without anything of what they test."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.identify.fit.robust import (
    Loss,
    bulk_scale,
    covariance_factor,
    descend_to_tukey_weights,
    median_scale,
    tukey_limit,
)


def plane(seed, rows=120, wrong=0.0, noise=0.02, clustered=True):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(rows, 3, 6))
    truth = rng.normal(size=6)
    y = X @ truth + noise * rng.normal(size=(rows, 3))
    bad = rng.permutation(rows)[: round(wrong * rows)]
    y[bad] += [0.5, 0.0, 0.0] if clustered else rng.normal(size=(len(bad), 3))
    return X, y, truth, bad


def solve(X, y, weight):
    root = np.sqrt(weight)[:, None]
    A = (X * root[..., None]).reshape(-1, X.shape[2])
    return np.linalg.lstsq(A, (y * root).reshape(-1), rcond=None)[0]


def robustly(X, y):
    def sizes(weight):
        return np.linalg.norm(y - X @ solve(X, y, weight), axis=1)

    return descend_to_tukey_weights(sizes, sizes(np.ones(len(y))), 3)


@pytest.mark.parametrize("clustered", [True, False])
@pytest.mark.parametrize("wrong", [0.15, 0.3])
def test_wrong_rows_alike_leave_the_fit_as_good_as_without_them(wrong, clustered):
    for seed in range(10):
        X, y, truth, bad = plane(seed, wrong=wrong, clustered=clustered)
        found = robustly(X, y)
        good = np.setdiff1d(np.arange(len(y)), bad)
        best = np.linalg.norm(solve(X[good], y[good], np.ones(len(good))) - truth)
        assert np.linalg.norm(solve(X, y, found.weight) - truth) < 2.0 * best + 1e-3
        assert abs(found.scale / 0.02 - 1.0) < 0.2
        far = bad if clustered else bad[found.size[bad] > 0.12]
        assert (found.weight[far] == 0.0).all()


def test_good_rows_cost_little():
    """Efficiency on normal rows is the one promised."""
    error = {"plain": 0.0, "robust": 0.0}
    for seed in range(200):
        X, y, truth, _ = plane(seed, rows=60)
        error["plain"] += float(np.sum((solve(X, y, np.ones(60)) - truth) ** 2))
        error["robust"] += float(np.sum((solve(X, y, robustly(X, y).weight) - truth) ** 2))
    assert error["plain"] / error["robust"] > 0.9


@pytest.mark.parametrize("kind", ["huber", "tukey"])
def test_hubers_factor_makes_a_covariance(kind):
    """Squared errors over the covariance average to one, where the weighted normal matrix gives too small a covariance."""
    limit = {"huber": 1.0, "tukey": tukey_limit(3)}[kind] * 0.02
    loss, ratio, naive = Loss(kind, limit), [], []
    for seed in range(150):
        X, y, truth, _ = plane(seed, rows=40)
        beta = solve(X, y, np.ones(40))
        for _ in range(20):
            size = np.linalg.norm(y - X @ beta, axis=1)
            beta = solve(X, y, loss.weight(size))
        J = X.reshape(-1, 6)
        size = np.linalg.norm(y - X @ beta, axis=1)
        covariance = np.linalg.inv(J.T @ J) * covariance_factor(size, 3, loss, 6)
        ratio.append((beta - truth) @ np.linalg.solve(covariance, beta - truth) / 6)
        w = loss.weight(size)
        left = np.sum(w * size**2) / (120 - 6)
        weighted = np.linalg.inv(J.T @ (np.repeat(w, 3)[:, None] * J)) * left
        naive.append((beta - truth) @ np.linalg.solve(weighted, beta - truth) / 6)
    assert abs(np.mean(ratio) - 1.0) < 0.15
    assert abs(np.mean(ratio) - 1.0) < abs(np.mean(naive) - 1.0) + 0.05


@pytest.mark.parametrize(("dimension", "known"), [(1, 4.685), (2, 5.12), (3, 5.49)])
def test_tukeys_limits_are_those_of_the_tables(dimension, known):
    assert tukey_limit(dimension) == pytest.approx(known, abs=0.08)


def test_scales_are_those_of_one_coordinate():
    size = np.linalg.norm(np.random.default_rng(0).normal(0.0, 0.3, (4000, 3)), axis=1)
    assert median_scale(size, 3) == pytest.approx(0.3, rel=0.05)
    assert bulk_scale(np.r_[size, np.full(800, 5.0)], 3, median_scale(size, 3)) == pytest.approx(0.3, rel=0.03)
    assert median_scale(np.zeros(0), 3) == 0.0


@pytest.mark.parametrize("kind", ["huber", "tukey"])
def test_the_loss_is_the_integral_of_what_its_weights_say(kind):
    loss, size, step = Loss(kind, 2.0), np.linspace(0.01, 5.0, 50), 1e-6
    slope = (loss.rho(size + step) - loss.rho(size - step)) / (2 * step)
    assert np.allclose(slope, loss.weight(size) * size, atol=1e-6)
    smooth = np.abs(size - 2.0) > 0.01
    bend = (loss.weight(size + step) * (size + step) - loss.weight(size - step) * (size - step)) / (2 * step)
    assert np.allclose(bend[smooth], loss.slope(size)[smooth], atol=1e-5)


def test_rows_without_noise_end():
    X, _, truth, _ = plane(0)
    y = X @ truth
    y[3] += 1.0
    found = robustly(X, y)
    assert np.allclose(solve(X, y, found.weight), truth)
    assert found.weight[3] == 0.0


def test_a_descent_ends_where_what_it_is_for_is_decided():
    X, y, _, bad = plane(1, wrong=0.3)
    fits, asked = [], []

    def sizes(weight):
        fits.append(weight)
        return np.linalg.norm(y - X @ solve(X, y, weight), axis=1)

    def decided(size):
        asked.append(size)
        return True

    found = descend_to_tukey_weights(sizes, sizes(np.ones(len(y))), 3, decided)
    assert len(asked) == 1
    assert len(fits) > 3  # the limit came all the way down first
    assert (found.weight[bad] == 0.0).all()
