"""The comparison of two commits sees what differs, and the record loses no bit."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.frozen.compare import differences
from tests.frozen.record import IDENTIFICATIONS, exact, one

LAST_BIT = np.nextafter(0.1, 1.0)


def test_numbers_are_written_to_their_last_bit() -> None:
    values = np.random.default_rng(0).normal(size=(5, 3)) * 10.0 ** np.arange(-9, 6, 5)
    assert np.array_equal(json.loads(json.dumps(exact({"values": values})))["values"], values)
    assert exact((np.float64(LAST_BIT), np.int64(3), np.bool_(True))) == [LAST_BIT, 3, True]


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        ({"a": 0.1}, {"a": LAST_BIT}, ".a: 0.1 became"),
        ({"a": [1.0, 2.0]}, {"a": [1.0]}, ".a: 2 became 1"),
        ({"a": 1}, {"b": 1}, "keys ['a', 'b']"),
        ({"a": "closed"}, {"a": "no_gap"}, "'closed' became 'no_gap'"),
        ({"a": None}, {"a": 0.0}, "None became 0.0"),
        ({"a": True}, {"a": 1}, "True became 1"),
    ],
)
def test_what_differs_is_named(before: object, after: object, told: str) -> None:
    assert told in " ".join(differences(before, after, 0.0))
    assert not list(differences(before, before, 0.0))


def test_rounding_is_judged_beside_the_largest_of_a_list() -> None:
    before, after = [1.0, 1e-12, float("nan")], [1.0 + 1e-13, 3e-12, float("nan")]
    assert len(list(differences(before, after, 0.0))) == 2
    assert not list(differences(before, after, 1e-11))
    assert list(differences(1e-12, 3e-12, 1e-11))


def test_a_part_is_the_same_when_it_is_run_again() -> None:
    assert len(IDENTIFICATIONS) >= 20
    name = "positions, level 1"
    first, second = (json.loads(json.dumps(one((name, None))[1])) for _ in range(2))
    assert not list(differences(first, second, 0.0))
    assert first["calibration"]["values"]
