"""A hunt looks for the effects, and at the joints, that it was asked to."""

from __future__ import annotations

from typing import Any

import pytest

from kilter_core.errors import OptionError
from kilter_core.gap import GapOptions
from kilter_core.gap.search.candidates import build_library
from tests.core.gap.simulated import campaign, katana

ROWS = campaign(katana(), seed=2)


def test_candidates_are_at_the_joints_named_only() -> None:
    only = ["drift", {"id": "backlash", "joints": [2, 3]}, {"id": "joint_coupling", "joints": [3]}]
    found = build_library(katana(), ROWS, only=only)
    assert {(c.id, c.joints) for c in found.candidates if c.id == "backlash"} == {
        ("backlash", (1,)), ("backlash", (2,)), ("backlash", (1, 2)),
    }  # fmt: skip
    assert {c.joints for c in found.candidates if c.id == "joint_coupling"} == {(2,)}
    assert {c.id for c in found.candidates} == {"drift", "backlash", "joint_coupling"}
    assert {p.name for p in found.parameters if p.name.startswith("backlash")} == {"backlash_2", "backlash_3"}


@pytest.mark.parametrize(
    ("one", "said"),
    [
        ("ghost", "no effect 'ghost'"),
        ({"id": "ghost"}, "no effect 'ghost'"),
        ("load_error", "carried by every search"),
        ({"id": "unknown_residual"}, "learned, not searched"),
        ({"id": "clearance_tilt", "softening_nm": 1.0}, "chooses softening_nm of clearance_tilt itself"),
        ({"id": "drift", "joints": [1]}, "does not act at joints"),
        ({"id": "backlash", "joints": [0]}, "joint numbers from 1"),
        ({"id": "backlash", "joints": [9]}, "at joint 9, the robot has 5"),
    ],
)
def test_what_cannot_be_looked_for_is_refused(one: Any, said: str) -> None:
    with pytest.raises(OptionError, match=said):
        build_library(katana(), ROWS, only=GapOptions.from_document({"effects": [one]}).effects)
