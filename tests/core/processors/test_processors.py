"""The same campaign gives the same calibration on every processor: held directions, names, values, words.

The linear algebra library has kernels for each kind of processor, which round differently; it can be told which to take.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kilter_core.identify.identifiability import null_directions
from tests.core.processors.compared import CORES, differences, touched, under
from tests.core.processors.fitting import fitted
from tests.core.processors.made import KINDS, campaigns


@pytest.mark.parametrize("kinds", [2, pytest.param(len(CORES), marks=pytest.mark.slow)])
def test_every_kind_of_measurement_gives_the_same_under_every_kind_of_processor(tmp_path: Path, kinds: int) -> None:
    """Under two kinds that this processor can be, or under all."""
    some, found = list(campaigns(0)), {}
    for core in CORES:
        if len(found) < kinds and (answers := under(core, some, tmp_path)) is not None:
            found[core] = answers
    assert len(found) >= 2, "this processor runs the kernels of one kind only"
    first = next(iter(found))
    assert {one.kind for one in some if "refused" not in found[first][one.name]} == set(KINDS)
    said = [
        f"{one.name}, {core}: {difference}"
        for one in some
        for core in found
        for difference in differences(found[first][one.name], found[core][one.name])
    ]
    assert said == []


@pytest.mark.parametrize("seed", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_no_decision_hangs_on_the_last_digits_of_the_data(seed: int) -> None:
    """Layouts with ties, where a rounding error could decide what is held, named or where a ball bar stands."""
    said = [
        f"{one.name}: {difference}"
        for one in campaigns(seed)
        for difference in differences(fitted(one), fitted(touched(one, seed)))
    ]
    assert said == []


def test_directions_seen_alike_are_named_alike_in_whatever_mixture_they_come() -> None:
    """Two aliases of equal weight, and two weak directions of one singular value: a processor may turn their basis."""
    rng = np.random.default_rng(0)
    names, prior = tuple("abcdefg"), np.full(7, 1e-2)
    J = rng.normal(size=(60, 7)) * 1e4
    J[:, 1], J[:, 3] = J[:, 0], -J[:, 2]
    weak = np.linalg.qr(rng.normal(size=(60, 2)))[0]
    J[:, 5:] = 30.0 * (weak - J[:, :5] @ np.linalg.lstsq(J[:, :5], weak, rcond=None)[0])
    J[:, 5:] = 30.0 * np.linalg.qr(J[:, 5:])[0]
    said = [direction.sentence() for direction in null_directions(J, names, prior)]
    assert said[:2] == ["a cannot be told from b in these poses.", "c cannot be told from d in these poses."]
    for _ in range(20):
        turned = np.linalg.qr(rng.normal(size=(60, 60)))[0] @ J
        assert [direction.sentence() for direction in null_directions(turned, names, prior)] == said
