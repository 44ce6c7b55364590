from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from kilter_core.gap.evidence.held_out.held_out_errors import surely_predicted

POSES = np.repeat(np.arange(20), 2)


def errors(rng: np.random.Generator, true: float, said: float) -> tuple[np.ndarray, np.ndarray]:
    """Errors of 20 poses with and without an effect of root non-centrality ``true``, of which ``said`` is predicted."""
    shape = rng.standard_normal((40, 3))
    shape /= np.linalg.norm(shape)
    without = true * shape + rng.standard_normal((40, 3))
    return without, without - said * shape


@pytest.mark.parametrize("said", [1.0, 6.0])
def test_without_an_effect_deviations_are_standard_normal(said):
    rng = np.random.default_rng(1)
    found = np.array([surely_predicted(*errors(rng, 0.0, said), POSES) for _ in range(4000)])
    assert abs(found.mean()) < 0.1
    assert np.mean(found > norm.isf(0.05)) == pytest.approx(0.05, abs=0.015)
    assert np.mean(found > 3.0) < 0.005


def test_a_true_effect_stands_out_by_its_root_non_centrality():
    rng = np.random.default_rng(2)
    found = np.array([surely_predicted(*errors(rng, 6.0, 5.0), POSES) for _ in range(500)])
    assert 4.0 < np.median(found) < 6.5
    assert np.mean(found > 3.0) > 0.9


def test_rows_of_one_pose_count_once():
    rng = np.random.default_rng(3)
    without, with_ = errors(rng, 3.0, 3.0)
    once = surely_predicted(without, with_, POSES)
    copied = surely_predicted(np.tile(without, (5, 1)), np.tile(with_, (5, 1)), np.tile(POSES, 5))
    assert copied == pytest.approx(once)


def test_the_wrong_way_is_negative_and_nothing_is_zero():
    rng = np.random.default_rng(4)
    without, with_ = errors(rng, 6.0, -5.0)
    assert surely_predicted(without, with_, POSES) < -3.0
    assert surely_predicted(without, without, POSES) == 0.0
    assert surely_predicted(without[:2], with_[:2], POSES[:2]) == 0.0
