"""Probabilities in sentences: none is said to be nothing."""

from __future__ import annotations

import pytest

from kilter_service.contract.wording import said_of_chance


@pytest.mark.parametrize(
    ("value", "said"), [(0.25, "0.25"), (0.04, "0.04"), (3e-5, "3e-5"), (2e-56, "below 1e-6"), (0.0, "below 1e-6")]
)
def test_a_chance_that_rounds_to_none_is_said_to_be_below_what_is_told(value: float, said: str) -> None:
    assert said_of_chance(value) == said
