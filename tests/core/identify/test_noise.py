"""Noise from repeats."""

from __future__ import annotations

import numpy as np
import pytest

from core.identify.noise import repeat_sigma
from core.observations import Observations


def test_repeats_give_the_noise_whatever_the_model() -> None:
    rng = np.random.default_rng(0)
    ids = np.repeat(np.arange(400), rng.integers(1, 5, 400))
    places = rng.uniform(-1.0, 1.0, (400, 3))
    o = Observations(
        np.asarray(ids[:, None] * 0.01, dtype=np.float64),
        position=places[ids] + rng.normal(0.0, 3e-5, (len(ids), 3)),
        pose_id=ids,
    )
    assert repeat_sigma(o) == pytest.approx(3e-5, rel=0.05)


def test_the_estimate_is_unbiased_with_two_repeats_each() -> None:
    rng = np.random.default_rng(1)
    ids = np.repeat(np.arange(2000), 2)
    o = Observations(
        np.asarray(ids[:, None] * 0.01, dtype=np.float64), position=rng.normal(0.0, 1.0, (4000, 3)), pose_id=ids
    )
    assert repeat_sigma(o) == pytest.approx(1.0, rel=0.03)


def test_without_repeats_there_is_none() -> None:
    q = np.arange(5.0)[:, None]
    assert repeat_sigma(Observations(q, position=np.zeros((5, 3)))) is None
    assert repeat_sigma(Observations(q)) is None


def test_rows_with_a_hidden_marker_are_left_out() -> None:
    rng = np.random.default_rng(2)
    markers = rng.normal(0.0, 1e-4, (300, 3, 3))
    markers[::7, 1] = np.nan
    o = Observations(np.zeros((300, 2)), markers=markers)
    assert repeat_sigma(o) == pytest.approx(1e-4, rel=0.06)
