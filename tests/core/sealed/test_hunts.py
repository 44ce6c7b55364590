"""A version of a search is no worse on the other half of a real campaign than the geometry, beyond chance."""

from pathlib import Path

import pytest

from kilter_core.gap import GapOptions
from tests.core.sealed.hunts import describe, hunts


@pytest.mark.parametrize(("name", "begin"), [("fanuc", "by chance 2"), ("talos", "by chance")])
def test_halves_of_real_campaigns(shared_data: Path, name: str, begin: str) -> None:
    found = list(hunts(shared_data, name, GapOptions(next_poses=0), begin))
    assert found
    assert [next(describe(one)) for one in found if one.is_worse] == []
    replicated = {j.claim.words for one in found for j in one.report.effects if j.verdict == "replicated"}
    assert bool(replicated) is (name == "talos")  # twelve configurations hold none out
