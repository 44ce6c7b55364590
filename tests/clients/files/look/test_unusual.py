"""What is said of a value outside its physical range: a negative backlash is no large one."""

from __future__ import annotations

import pytest

from kilter_files.look.summaries import why_unusual


@pytest.mark.parametrize(
    ("name", "value", "sigma", "words"),
    [
        ("backlash_load_2", -0.01, 0.02, "not seen: below 0 by less than its uncertainty"),
        ("backlash_load_2", -0.17, 0.02, "below 0, which cannot be: check masses, payload and how the base stands, or "
         "look for what is missing in the model"),
        ("backlash_load_2", -0.17, None, "below 0, which cannot be: check masses, payload and how the base stands, or "
         "look for what is missing in the model"),
        ("lag_1", -0.1, 0.01, "below 0, which cannot be: look for what is missing in the model"),
        ("backlash_load_2", 3.0, 0.02, "outside its physical range: look for what is missing in the model"),
        ("theta_offset_2", -12.0, 0.02, "outside its physical range: look for what is missing in the model"),
    ],
)  # fmt: skip
def test_a_negative_value_says_what_it_means(name: str, value: float, sigma: float | None, words: str) -> None:
    assert why_unusual(name, value, sigma) == words
