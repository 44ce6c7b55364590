"""Intervals hold the truth where rows of a pose share their error: shots of one stop, and how the arm came to rest there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.uncertainty.clustered import with_clustered_covariance
from kilter_core.observations import Observations
from tests.core.campaigns import joints, measured
from tests.core.identify.test_identify import FIXED, fixed_frames

Floats = NDArray[np.float64]
SHOT, REST, SETTLE = 1e-5, 6e-5, 1e-4


def stops(seed: int, poses: int, shots: int, kind: str) -> tuple[Floats, Floats]:
    """Errors over sigma of the parameters that the data taught, and along the directions they taught."""
    robot, true, errors, rng = fixed_frames(seed)
    place = np.repeat(np.arange(poses), shots)
    q = joints(true, poses, rng)[place]
    moved = q + rng.normal(0.0, SETTLE, (poses, 6))[place] if kind == "joints" else q
    position = true.poses(moved)[0] + rng.normal(0.0, SHOT, (len(q), 3))
    if kind == "tool":
        position += rng.normal(0.0, REST, (poses, 3))[place]
    found = identify(robot, Observations(q, position=position), None, FIXED)
    model = found.calibration.model
    wrong = np.array(
        [found.calibration.values[model.names.index(n)] - model.parameter(n).value - errors[n] for n in errors]
    )
    prior = found.fit.problem.prior_sigma
    sigma = np.sqrt(np.diag(found.covariance))
    variance, V = np.linalg.eigh(found.covariance / np.outer(prior, prior))
    taught = variance < 1e-3
    return (wrong / sigma)[sigma < 0.3 * prior], (V[:, taught].T @ (wrong / prior)) / np.sqrt(variance[taught])


@pytest.mark.parametrize(("poses", "shots", "kind"), [(20, 3, "tool"), (40, 3, "joints"), (60, 1, "shots")])
def test_three_shots_of_a_stop_are_not_three_poses(poses: int, shots: int, kind: str) -> None:
    found = [stops(seed, poses, shots, kind) for seed in range(25)]
    for z in (np.concatenate([f[k] for f in found]) for k in (0, 1)):
        assert np.mean(np.abs(z) < 1.96) == pytest.approx(0.95, abs=0.03)


def test_repeating_every_row_teaches_nothing() -> None:
    robot, true, _, rng = fixed_frames(3)
    once = measured(true, joints(true, 50, rng), rng, REST)
    thrice = once.select(np.repeat(np.arange(50), 3))
    sigmas = [np.sqrt(np.diag(identify(robot, rows, None, FIXED).covariance)) for rows in (once, thrice)]
    np.testing.assert_allclose(sigmas[1], sigmas[0], rtol=0.12)


def test_a_pose_that_alone_tells_a_parameter_does_not_make_it_certain() -> None:
    """The fit follows such a pose wholly: no residual is left there to show how far off it may be."""
    robot, true, _, rng = fixed_frames(4)
    q = joints(true, 40, rng)
    q[:, 5] = 0.3
    q[7, 5] = -1.2
    fit = identify(robot, measured(true, q, rng, REST), None, FIXED).fit
    plain = np.linalg.inv(fit.J.T @ fit.J + np.diag(fit.problem.prior_sigma**-2.0))
    c = fit.names.index("theta_offset_6")
    assert fit.sigma[c] > 0.5 * np.sqrt(plain[c, c])


def test_the_loss_does_not_make_parameters_surer() -> None:
    robot, true, _, rng = fixed_frames(5)
    rows = measured(true, joints(true, 80, rng), rng, REST)
    sigma = {}
    for loss in ("linear", "huber", "tukey"):
        found = identify(robot, rows, None, replace(FIXED, loss=loss))
        sigma[loss] = np.sqrt(np.diag(found.covariance))
        assert found.fit.freedom is not None
    seen = sigma["linear"] < 1e-3
    assert np.median(sigma["huber"][seen] / sigma["linear"][seen]) == pytest.approx(1.0, abs=0.12)
    assert np.median(sigma["tukey"][seen] / sigma["linear"][seen]) == pytest.approx(1.03, abs=0.12)


def test_distances_keep_their_covariance() -> None:
    robot, true, _, rng = fixed_frames(6)
    rows = measured(true, joints(true, 60, rng), rng, REST)
    fit = identify(robot, rows, None, IdentifyOptions(level=1, base="removed", tool="fixed")).fit
    assert with_clustered_covariance(fit) is fit
