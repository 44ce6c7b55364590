"""Scatter that differs from pose to pose, on scatter that was drawn so."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.identify.uncertainty.clustered import scatter_of_poses

Floats = NDArray[np.float64]


def drawn(cartesian: float, joints: list[float], poses: int, seed: int) -> tuple[Floats, Floats]:
    """Residuals of poses whose joints settle with these scatters, and the levers by which they move the tool."""
    rng = np.random.default_rng(seed)
    lever = rng.normal(size=(poses, 3, len(joints))) * rng.uniform(0.1, 2.0, (poses, 1, 1))
    settled = np.einsum("gij,gj->gi", lever, rng.normal(size=(poses, len(joints))) * joints)
    return settled + cartesian * rng.normal(size=(poses, 3)), lever


def found(residual: Floats, lever: Floats, own: float = 0.0) -> Floats:
    common = residual.T @ residual / len(residual)
    return scatter_of_poses(residual, lever, common, np.tile(own * np.eye(3), (len(residual), 1, 1)))


@pytest.mark.parametrize(("cartesian", "joints"), [(0.5, [1.0, 0.0, 0.7, 0.3]), (0.1, [1.0, 0.5, 0.0, 0.0])])
def test_joints_that_settle_are_told_from_a_scatter_of_the_tool(cartesian: float, joints: list[float]) -> None:
    residual, lever = drawn(cartesian, joints, 4000, 0)
    true = (lever * np.square(joints)) @ lever.transpose(0, 2, 1) + cartesian**2 * np.eye(3)
    told = np.trace(found(residual, lever), axis1=1, axis2=2)
    expected = np.trace(true, axis1=1, axis2=2)
    assert np.std(told / expected) < 0.12
    assert np.corrcoef(told, expected)[0, 1] > 0.99


def test_scatter_of_the_tool_alone_stays_the_same_everywhere() -> None:
    residual, lever = drawn(1.0, [0.0] * 5, 2000, 1)
    np.testing.assert_allclose(np.trace(found(residual, lever), axis1=1, axis2=2), 3.0, rtol=0.25)


def test_few_poses_tell_no_shares() -> None:
    residual, lever = drawn(1.0, [1.0, 1.0, 1.0], 12, 2)
    each = found(residual, lever)
    np.testing.assert_array_equal(each, np.broadcast_to(each[0], each.shape))


def test_on_average_it_is_the_scatter_that_was_drawn() -> None:
    totals = []
    for seed in range(60):
        residual, lever = drawn(0.6, [0.8, 0.2, 0.0], 40, seed)
        true = (lever * np.square([0.8, 0.2, 0.0])) @ lever.transpose(0, 2, 1) + 0.36 * np.eye(3)
        totals.append(np.trace(found(residual, lever).mean(axis=0)) / np.trace(true.mean(axis=0)))
    assert np.mean(totals) == pytest.approx(1.0, abs=0.06)


def test_numbers_that_a_pose_lacks_say_nothing_of_its_scatter() -> None:
    """A tracker saw a third of the poses, a camera the others: zeros for the rest would lend their scatter to the joints."""
    totals = []
    for seed in range(40):
        rng = np.random.default_rng([seed, 8])
        tracked = np.arange(36) % 3 == 0
        seen = np.concatenate([np.repeat(tracked[:, None], 3, axis=1), np.repeat(~tracked[:, None], 6, axis=1)], axis=1)
        lever = rng.normal(size=(36, 9, 4)) * rng.uniform(0.1, 2.0, (36, 1, 1)) * seen[:, :, None]
        residual = rng.normal(size=seen.shape) * seen
        both = np.maximum(seen.T.astype(float) @ seen, 1.0)
        each = scatter_of_poses(residual, lever, residual.T @ residual / both, np.zeros((36, 9, 9)), seen)
        assert not each[~seen].any()
        along = lever / np.linalg.norm(lever, axis=1, keepdims=True)
        totals.append(np.mean(np.einsum("gij,gik,gkj->gj", along, each, along)))
    assert np.mean(totals) == pytest.approx(1.0, abs=0.1)
