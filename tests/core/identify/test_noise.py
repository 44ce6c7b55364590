"""Noise from repeats."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.identify.measured_rows import Repeats, repeat_sigma
from kilter_core.observations import Observations

Ints = NDArray[np.int64]


def campaign(order: Ints, seed: int, sigma: float = 3e-5, **columns: Any) -> Observations:
    """Poses by number, in the order in which they are measured, each at a place of its own."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1.0, 1.0, (int(order.max()) + 1, 3))
    q = rng.uniform(-2.0, 2.0, (len(places), 4))[order]
    return Observations(q, position=places[order] + rng.normal(0.0, sigma, (len(order), 3)), **columns)


def test_visits_of_a_pose_give_the_noise_whatever_the_model() -> None:
    rng = np.random.default_rng(0)
    order = rng.permutation(np.repeat(np.arange(400), rng.integers(1, 5, 400)))
    assert repeat_sigma(campaign(order, 1)) == pytest.approx(3e-5, rel=0.06)


def test_the_estimate_is_unbiased_with_two_visits_each() -> None:
    order = np.tile(np.arange(2000), 2)
    assert repeat_sigma(campaign(order, 2)) == pytest.approx(3e-5, rel=0.03)


def test_shots_of_one_visit_are_not_how_the_arm_comes_to_rest() -> None:
    """Three shots a stop: nine micrometres were said where sixty are true. The clock parts no visit."""
    rng = np.random.default_rng(3)
    visits = np.tile(np.arange(60), 2)
    order = np.repeat(visits, 3)
    o = campaign(order, 3, 9e-6, t=np.cumsum(rng.uniform(1.0, 400.0, 360)))
    assert o.position is not None
    rest = np.repeat(rng.normal(0.0, 6e-5, (120, 3)), 3, axis=0)
    found = Repeats.from_observations(replace(o, position=o.position + rest))
    assert found.shots == pytest.approx(9e-6, rel=0.1)
    assert found.between == pytest.approx(np.hypot(6e-5, 9e-6), rel=0.15)
    once = Repeats.from_observations(replace(o, position=o.position + rest).select(slice(0, 180)))
    assert (once.between, once.shots) == (None, pytest.approx(9e-6, rel=0.15))


def test_rows_sorted_by_pose_are_visits_by_the_clock() -> None:
    """A table sorted by pose looks like shots of one visit each; its clock says that the arm came back every time."""
    rng = np.random.default_rng(5)
    order = np.tile(np.arange(300), 3)
    o = campaign(order, 5, 4e-5, t=np.cumsum(rng.uniform(1.0, 9.0, 900)))
    by_pose = o.select(np.argsort(order, kind="stable"))
    np.testing.assert_array_equal(np.bincount(by_pose.visits()), np.ones(900))
    found, known = Repeats.from_observations(by_pose), Repeats.from_observations(o)
    assert (found.shots, known.shots) == (None, None)
    assert found.between == pytest.approx(known.between, rel=1e-9)


@pytest.mark.parametrize("told", [True, False])
def test_the_two_sides_of_a_pose_are_no_noise(told: bool) -> None:
    """Play of 0.1 mm, seen or not in a column of directions: rows in between show how the arm came."""
    rng = np.random.default_rng(4)
    stops = np.tile(np.arange(40), 6)
    o = campaign(stops, 4, 1e-5)
    side = rng.choice([-1.0, 1.0], len(stops))
    q = np.repeat(o.q, 2, axis=0)
    q[::2] -= 0.1 * side[:, None]
    assert o.position is not None
    position = np.repeat(o.position + 5e-5 * side[:, None], 2, axis=0)
    position[::2] += rng.normal(0.0, 0.1, (len(stops), 3))
    direction = np.repeat(side[:, None] * np.ones(4), 2, axis=0)
    rows = Observations(q, position=position, direction=direction if told else None)
    assert repeat_sigma(rows) == pytest.approx(1e-5, rel=0.1)


def test_wrong_readings_are_named_and_no_noise() -> None:
    order = np.tile(np.arange(100), 3)
    o = campaign(order, 5)
    assert o.position is not None
    hit = np.array([7, 130, 131, 255])
    position = o.position.copy()
    position[hit] += 5e-4
    found = Repeats.from_observations(replace(o, position=position))
    assert found.wrong.tolist() == hit.tolist()
    assert found.between == pytest.approx(3e-5, rel=0.1)


def test_without_repeats_there_is_none() -> None:
    q = np.arange(5.0)[:, None]
    assert repeat_sigma(Observations(q, position=np.zeros((5, 3)))) is None
    assert repeat_sigma(Observations(q)) is None


def test_rows_with_a_hidden_marker_are_left_out() -> None:
    rng = np.random.default_rng(2)
    markers = rng.normal(0.0, 1e-4, (300, 3, 3))
    markers[::7, 1] = np.nan
    o = Observations(np.zeros((300, 2)), markers=markers)
    assert Repeats.from_observations(o).shots == pytest.approx(1e-4, rel=0.06)


def test_copies_of_rows_are_no_repeats() -> None:
    """A file pasted twice under itself: 60 poses that were measured once had a noise of nothing, *from repeats*."""
    once = campaign(np.arange(60), 8)
    twice = Repeats.from_observations(Observations.concatenate([once, once]))
    assert (twice.between, twice.shots) == (None, None)
    np.testing.assert_array_equal(twice.copies, np.arange(60, 120))
    real = campaign(np.tile(np.arange(60), 2), 8)
    assert (
        Repeats.from_observations(real).between
        == Repeats.from_observations(Observations.concatenate([real, real.select(np.arange(9))])).between
    )
