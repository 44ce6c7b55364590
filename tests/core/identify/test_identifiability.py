"""Null directions: found, told apart from weak ones, and named in words."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.identify.identifiability import identifiable, null_directions

NAMES = ("a", "b", "c", "d")


def jacobian(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(50, 4)) * 1e4


def test_data_that_see_everything_leave_no_direction() -> None:
    assert null_directions(jacobian(np.random.default_rng(0)), NAMES, np.full(4, 1e-2)) == ()


def test_a_parameter_without_effect_is_named_alone() -> None:
    J = jacobian(np.random.default_rng(1))
    J[:, 2] = 0.0
    (blind,) = null_directions(J, NAMES, np.full(4, 1e-2))
    assert blind.structural
    assert blind.sentence() == "c has no effect on these measurements; it keeps its starting value."


def test_aliases_are_named_one_by_one_with_weights_that_cancel() -> None:
    J = jacobian(np.random.default_rng(2))
    J[:, 1] = -2.0 * J[:, 0]
    J[:, 3] = 0.5 * J[:, 2]
    found = null_directions(J, NAMES, np.array([1e-2, 1e-3, 1e-2, 1e-3]))
    assert {frozenset(name for name, _ in d.weights) for d in found} == {frozenset("ab"), frozenset("cd")}
    for d in found:
        assert d.structural
        # Weights compare what each member does to the measurements, so those of two aliases are equal and opposite.
        assert [abs(w) for _, w in d.weights] == pytest.approx([1.0, 1.0])
    assert any("cannot be told from" in d.sentence() for d in found)


def test_a_weak_direction_is_not_called_structural() -> None:
    rng = np.random.default_rng(3)
    J = jacobian(rng)
    J[:, 1] = J[:, 0] + rng.normal(size=50) * 5.0
    (weak,) = null_directions(J, NAMES, np.full(4, 1e-2))
    assert not weak.structural
    assert 0.0 < weak.learned < 0.5
    assert "can hardly be told from" in weak.sentence()


def test_fewer_rows_than_parameters_leave_the_rest_blind() -> None:
    found = null_directions(np.random.default_rng(4).normal(size=(3, 4)) * 1e4, NAMES, np.full(4, 1e-2))
    assert len(found) == 1


def test_identifiable_means_three_quarters_of_the_prior_variance_gone() -> None:
    assert identifiable(np.array([0.1, 0.49, 0.51, 1.0]), np.ones(4)).tolist() == [True, True, False, False]
