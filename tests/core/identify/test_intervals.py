"""Intervals against refits of resampled data and against scipy's minima; observability against textbook numbers."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import scipy.optimize
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import OptionError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.fit.least_squares import Fit, Problem, Weights, solve
from kilter_core.identify.steps.report import correlated_groups, observability
from kilter_core.identify.uncertainty.stated_noise import bootstrap, profile
from kilter_core.measurement import Measurement
from kilter_core.model import RobotModel
from tests.core.campaigns import joints, measured, table_errors
from tests.core.truth import small_pose, ur10

Floats = NDArray[np.float64]
NOISE = 5e-5


def quiet(fraction: float, stage: str) -> None:
    pass


@cache
def fitted() -> Fit:
    rng = np.random.default_rng(0)
    nominal = ur10(tool=small_pose(rng, 0.1, 0.3))
    true = nominal.moved(table_errors(nominal, rng))
    model = RobotModel(robot_from_document(nominal.document()))
    measurement = Measurement.from_observations(measured(true, joints(true, 60, rng), rng, NOISE, "pose"))
    return solve(
        Problem(model, measurement, np.arange(6, model.n_geometric - 6), Weights(NOISE, NOISE)), model.values0()
    )


def test_a_bootstrap_step_is_a_refit() -> None:
    """The same resampled poses, fitted fully by the solver."""
    fit = fitted()
    n = 60
    found = bootstrap(fit, seed=3, progress=quiet, resamples=12)
    rng = np.random.default_rng(3)
    moves = []
    for _ in range(12):
        rows = np.repeat(np.arange(n), rng.multinomial(n, np.full(n, 1.0 / n)))
        o = fit.problem.measurement.observations
        # Rows are numbered by their joints in pose_groups; here each has its own, so the count per row is what matters.
        order = np.argsort(o.pose_groups())
        measurement = Measurement(o.select(order[rows]))
        again = solve(replace(fit.problem, measurement=measurement), fit.values)
        moves.append((again.values - fit.values)[fit.problem.free])
    low, high = np.percentile(moves, [2.5, 97.5], axis=0)
    np.testing.assert_allclose(found.lower / fit.sigma, low / fit.sigma, atol=0.01)
    np.testing.assert_allclose(found.upper / fit.sigma, high / fit.sigma, atol=0.01)


def test_a_thousand_resamples_agree_with_the_sigmas_of_well_seen_parameters() -> None:
    fit = fitted()
    found = bootstrap(fit, seed=0, progress=quiet)
    seen = fit.sigma < 0.01 * fit.problem.prior_sigma
    half = 0.5 * (found.upper - found.lower)[seen] / (1.96 * fit.sigma[seen])
    assert seen.sum() > 10
    assert half.mean() == pytest.approx(1.0, abs=0.2)


def test_a_profile_ends_where_scipy_says_the_loss_has_risen() -> None:
    fit = fitted()
    found = profile(fit, quiet)
    problem = fit.problem
    c = fit.names.index("theta_offset_3")
    others = np.arange(len(fit.names)) != c

    def residuals(x: Floats, move: float) -> Floats:
        values = fit.values.copy()
        step = np.zeros(len(fit.names))
        step[others], step[c] = x * problem.prior_sigma[others], move
        values[problem.free] += step
        prior = (values[problem.free] - problem.prior_mean) / problem.prior_sigma
        return np.concatenate([problem.whitened_residuals(values), prior])

    for move in (found.lower[c], found.upper[c]):
        least = scipy.optimize.least_squares(residuals, np.zeros(others.sum()), args=(move,), xtol=1e-14, ftol=1e-14)
        assert np.sqrt(2.0 * (least.cost - fit.cost)) == pytest.approx(1.96, rel=0.02)
    np.testing.assert_allclose(found.upper, 1.96 * fit.sigma, rtol=0.02)


@pytest.mark.parametrize("kind", ["bootstrap", "profile"])
def test_intervals_come_with_the_parameters(kind: str) -> None:
    rng = np.random.default_rng(1)
    nominal = ur10(tool=small_pose(rng, 0.1, 0.3))
    train = measured(nominal, joints(nominal, 40, rng), rng, NOISE, "pose")
    options: dict[str, Any] = {"level": 1, "base": "fixed", "tool": "fixed", "intervals": kind}
    result = identify(robot_from_document(nominal.document()), train, None, IdentifyOptions(**options)).to_document()
    assert result["intervals"] == kind
    assert all(p["lower"] < p["value"] < p["upper"] for p in result["parameters"])
    inside = [p["lower"] <= p["nominal"] <= p["upper"] for p in result["parameters"]]
    assert sum(inside) >= 4
    assert {p["interval_from"] for p in result["parameters"]} == {kind}
    assert result["observability"]["rank"] == 6
    with pytest.raises(OptionError, match="intervals"):
        IdentifyOptions(intervals="guess")


def test_observability_of_a_matrix_whose_singular_values_are_known() -> None:
    rng = np.random.default_rng(0)
    U, V = (np.linalg.qr(rng.normal(size=(n, n)))[0] for n in (30, 4))
    s = np.array([8.0, 4.0, 2.0, 0.0])
    found = observability(U[:, :4] * s @ V, poses=10)
    assert (found.rank, found.parameters) == (3, 4)
    assert found.o1 == pytest.approx(4.0 / np.sqrt(10.0))
    assert (found.o2, found.o3, found.o4, found.o5) == pytest.approx((0.25, 2.0, 0.5, 1.0 / 0.875))
    assert observability(np.zeros((6, 2)), 2).rank == 0


def test_parameters_that_go_together_are_named_together() -> None:
    names = ("a", "b", "c", "d", "e")
    C = np.diag([1.0, 4.0, 1.0, 9.0, 1.0])
    C[0, 1] = C[1, 0] = -1.9
    C[1, 3] = C[3, 1] = 5.5
    groups = correlated_groups(C, names)
    assert [g.names for g in groups] == [("a", "b", "d")]
    assert groups[0].strongest == pytest.approx(-0.95)
