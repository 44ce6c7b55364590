"""The solver against scipy's on the same residuals, and on residuals that Pinocchio computes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import NotConvergedError
from kilter_core.identify.fit.least_squares import Problem, Weights, solve
from kilter_core.measurement import Measurement
from kilter_core.model import RobotModel
from tests.core.campaigns import joints, measured, table_errors
from tests.core.truth import Arm, small_pose, ur10

NOISE = 5e-5
Floats = NDArray[np.float64]


def problem(see: str, loss: str = "linear", seed: int = 0) -> tuple[Problem, Floats, Arm]:
    rng = np.random.default_rng(seed)
    nominal = ur10(tool=small_pose(rng, 0.1, 0.3))
    true = nominal.moved(table_errors(nominal, rng))
    q = joints(true, 40, rng)
    model = RobotModel(robot_from_document(nominal.document()))
    measurement = Measurement.from_observations(measured(true, q, rng, NOISE, see))
    if loss == "huber" and measurement.observations.position is not None:
        position = measurement.observations.position.copy()
        position[3] += 0.01
        measurement = replace(measurement, observations=replace(measurement.observations, position=position))
    free = np.arange(6, model.n_geometric - 6)
    return Problem(model, measurement, free, Weights(NOISE, NOISE), loss), model.values0(), nominal


@pytest.mark.parametrize(
    ("see", "loss"), [("position", "linear"), ("pose", "linear"), ("markers", "linear"), ("position", "huber")]
)
def test_the_minimum_is_scipy_s(see: str, loss: str) -> None:
    task, start, _ = problem(see, loss)
    fit = solve(task, start)

    def residuals(x: Floats) -> Floats:
        values = start.copy()
        values[task.free] = task.prior_mean + x * task.prior_sigma
        return np.concatenate([task.whitened_residuals(values), x])

    theirs = scipy.optimize.least_squares(
        residuals, np.zeros(len(task.free)), jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    assert fit.cost == pytest.approx(theirs.cost, rel=1e-8)
    assert fit.cost <= theirs.cost * (1.0 + 1e-10)
    apart = (fit.values[task.free] - task.prior_mean - theirs.x * task.prior_sigma) / fit.sigma
    assert np.max(np.abs(apart)) < 2e-2


def test_the_minimum_is_scipy_s_with_residuals_of_pinocchio() -> None:
    task, start, nominal = problem("position")
    fit = solve(task, start)
    q, position = task.measurement.observations.q, task.measurement.observations.position
    assert position is not None

    def residuals(x: Floats) -> Floats:
        arm = nominal.moved(dict(zip(fit.names, x * task.prior_sigma, strict=True)))
        return np.concatenate([((position - arm.poses(q)[0]) / NOISE).reshape(-1), x])

    theirs = scipy.optimize.least_squares(residuals, np.zeros(len(fit.names)), xtol=1e-13, ftol=1e-13)
    assert fit.cost == pytest.approx(theirs.cost, rel=1e-8)


@pytest.mark.parametrize("see", ["position", "pose", "markers"])
def test_the_whitened_jacobian_is_the_slope_of_the_residuals(see: str) -> None:
    task, values, _ = problem(see)
    near = task.linearise(values)
    J = near.J
    np.testing.assert_allclose(near.r, task.whitened_residuals(values), atol=1e-12)
    for c, k in enumerate(task.free[::3]):
        there, back = values.copy(), values.copy()
        there[k] += 1e-6
        back[k] -= 1e-6
        slope = (task.whitened_residuals(there) - task.whitened_residuals(back)) / 2e-6
        np.testing.assert_allclose(-slope, J[:, 3 * c], atol=2e-3, rtol=1e-5)


def test_the_slope_is_that_of_huber_s_loss() -> None:
    task, values, _ = problem("position", "huber")
    near = task.linearise(values)
    for c, k in enumerate(task.free[::3]):
        there, back = values.copy(), values.copy()
        there[k] += 1e-7
        back[k] -= 1e-7
        slope = (task.linearise(there).loss - task.linearise(back).loss) / 2e-7
        prior = (values[k] - task.prior_mean[3 * c]) / task.prior_sigma[3 * c] ** 2
        assert -near.J[:, 3 * c] @ near.r + prior == pytest.approx(slope, rel=1e-5, abs=1.0)


def test_the_covariance_is_the_inverse_of_the_normal_matrix_with_the_priors() -> None:
    task, start, _ = problem("pose")
    fit = solve(task, start)
    expected = np.linalg.inv(fit.J.T @ fit.J + np.diag(1.0 / task.prior_sigma**2))
    np.testing.assert_allclose(
        fit.covariance / np.outer(fit.sigma, fit.sigma), expected / np.outer(fit.sigma, fit.sigma), atol=1e-6
    )
    assert fit.effective == pytest.approx(np.trace(fit.J @ fit.covariance @ fit.J.T), rel=1e-9)


def test_held_directions_do_not_move() -> None:
    task, start, _ = problem("position")
    held = np.linalg.qr(np.random.default_rng(1).normal(size=(len(task.free), 3)))[0].T
    fit = solve(replace(task, held=held, anchor=start[task.free]), start)
    moved = (fit.values - start)[task.free] / task.prior_sigma
    assert np.max(np.abs(held @ moved)) < 1e-4 * np.linalg.norm(moved)


def test_hidden_markers_weigh_nothing() -> None:
    task, start, _ = problem("markers")
    markers = task.measurement.observations.markers
    assert markers is not None
    hidden = markers.copy()
    hidden[4, 1] = np.nan
    measurement = replace(task.measurement, observations=replace(task.measurement.observations, markers=hidden))
    without = replace(task, measurement=measurement)
    near = without.linearise(start)
    assert not near.r.reshape(40, 3, 3)[4, 1].any()
    assert not near.J.reshape(40, 3, 3, -1)[4, 1].any()
    assert np.isfinite(solve(without, start).cost)


def test_impossible_numbers_do_not_converge() -> None:
    task, start, _ = problem("position")
    position = task.measurement.observations.position
    assert position is not None
    broken = replace(task.measurement.observations, position=np.where(np.arange(40)[:, None] == 2, np.inf, position))
    with pytest.raises(NotConvergedError, match="not finite"):
        solve(replace(task, measurement=replace(task.measurement, observations=broken)), start)
