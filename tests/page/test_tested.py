"""Why a candidate was not named, in words: when the number of names that were asked for is the reason, and when not."""

from __future__ import annotations

import pytest

from kilter_service.contract.jobs.gap import GapOptions, GapResult
from kilter_service.page.gap.story import candidates

LIMIT = "but no more effects than"


def said(effects: list[dict[str, object]], most: int) -> str:
    """The reason of an eccentricity that is far from chance, beside the effects that were named."""
    result = GapResult.model_validate({
        "effects": effects,
        "refused": [{"id": "eccentricity", "joints": [2], "explains": 0.1, "p_value": 1e-9}],
        "smallest_detectable": [
            {"id": "eccentricity", "parameter": "eccentricity_cos_2", "unit": "mrad", "smallest_detectable": 0.1}
        ],
    })  # fmt: skip
    return candidates(result, GapOptions(max_effects=most), "mm")[-1].reason


@pytest.mark.parametrize(
    ("named", "most", "full"),
    [
        ([("backlash", 1), ("backlash", 2), ("backlash", 3)], 2, False),
        ([("backlash", 1), ("backlash", 2), ("axial_compliance", 3)], 2, True),
        ([("unknown_joint_curve", 1), ("unknown_joint_curve", 2)], 2, True),
    ],
)
def test_joints_of_one_effect_fill_one_place_of_those_asked_for(
    named: list[tuple[str, int]], most: int, full: bool
) -> None:
    effects = [{"id": name, "joints": [j], "empirical": name.startswith("unknown")} for name, j in named]
    assert (LIMIT in said(effects, most)) is full
