"""Poses told by the distance of their joint readings."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from kilter_core.identify.holdout import fold_splits, split
from kilter_core.observations import Observations
from kilter_core.observations.repeats import _label_components, numbered_poses, numbered_rows, rounded_poses

Floats = NDArray[np.float64]


def test_rows_are_numbered_in_ascending_order_and_equal_ones_alike() -> None:
    rng = np.random.default_rng(3)
    keys = rng.integers(-2, 3, (400, 3))
    ordered = sorted({tuple(row) for row in keys.tolist()})
    assert numbered_rows(keys).tolist() == [ordered.index(tuple(row)) for row in keys.tolist()]
    assert numbered_rows(keys[:0]).tolist() == []


def repeated(poses: int, times: int, noise_deg: float, seed: int = 0) -> tuple[Floats, NDArray[np.int64]]:
    rng = np.random.default_rng(seed)
    of = np.repeat(np.arange(poses), times)
    q = rng.uniform(-2.0, 2.0, (poses, 6))[of]
    return q + np.radians(noise_deg) * rng.normal(size=q.shape), of


@pytest.mark.parametrize("noise_deg", [0.0, 1e-5, 1e-4, 1e-3])
def test_noise_of_the_readings_makes_no_poses(noise_deg: float) -> None:
    q, of = repeated(20, 3, noise_deg)
    shuffled = np.random.default_rng(1).permutation(len(q))
    found = numbered_poses(q[shuffled])
    assert found.max() == 19
    assert all(len(set(found[of[shuffled] == k].tolist())) == 1 for k in range(20))


def test_a_repeat_is_never_on_both_sides_of_a_split() -> None:
    q, of = repeated(20, 3, 1e-4)
    rows = Observations(q)
    sides = [split(rows, 0.3, seed) for seed in range(5)] + list(fold_splits(rows, 4, 0))
    assert all(not set(of[inside].tolist()) & set(of[outside].tolist()) for inside, outside in sides)


def test_numbers_ascend_with_the_readings_whatever_the_order_of_the_rows() -> None:
    q, _ = repeated(30, 2, 0.0)
    np.testing.assert_array_equal(numbered_poses(q), rounded_poses(q))
    q, _ = repeated(30, 3, 1e-4)
    shuffled = np.random.default_rng(1).permutation(len(q))
    np.testing.assert_array_equal(numbered_poses(q)[shuffled], numbered_poses(q[shuffled]))
    assert numbered_poses(q[:0]).tolist() == []


def test_the_rows_of_a_fine_motion_stay_poses_of_their_own() -> None:
    t = np.arange(20_000)[:, None] / 4600.0
    q = 0.3 * np.sin(0.7 * t + np.arange(7))
    assert numbered_poses(q).max() + 1 > 0.95 * len(q)


def test_a_rest_in_a_motion_ends_at_its_noise() -> None:
    """Rows that rest long at one place are one pose, however many they are."""
    q, of = repeated(4, 3000, 2e-4)
    assert np.unique(of + 4 * numbered_poses(q)).size == 4


@pytest.mark.parametrize("seed", range(20))
def test_a_chain_of_near_points_is_one_component(seed: int) -> None:
    rng = np.random.default_rng(seed)
    width = int(rng.integers(1, 5))
    points, along = np.cumsum(rng.normal(size=(300, width)) * 0.08, axis=0), rng.normal(size=width)
    points = points[np.argsort(points @ along)]
    near = (np.abs(points[:, None] - points[None]) <= 0.1).all(axis=2)
    found = _label_components(points, points @ along, 0.1, 0.1 * np.abs(along).sum())
    assert np.array_equal(found, connected_components(near)[1])  # both number by the first point
