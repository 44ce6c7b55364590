"""An arm that is not the one described is said to be another; one that was mastered or made badly is not. Truth: Pinocchio."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.gap import GapOptions, find_gap
from kilter_core.identify import Identification, identify
from kilter_core.identify.plausibility.believable import CODE, another_arm
from kilter_core.observations import Observations
from tests.core.campaigns import joints, measured, table_errors
from tests.core.truth import Arm, some_arm, ur10

QUICK = GapOptions(resamples=5, permutations=3, bootstraps=19, next_poses=0, effects=("backlash",))


def rows(arm: Arm, poses: int, seed: int) -> Observations:
    rng = np.random.default_rng(seed)
    return measured(arm, joints(arm, poses, rng), rng, 3e-5)


def identified(nominal: Arm, true: Arm, seed: int = 1) -> Identification:
    return identify(robot_from_document(nominal.document()), rows(true, 80, seed))


def said(found: Identification) -> list[str]:
    return [w["message"] for w in found.warnings if w["code"] == CODE]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"a_2": -0.052, "alpha_3": 0.35}, ("angle of axes 3 and 4", "distance of axes 2 and 3", "664 mm")),
        ({"a_3": -0.08, "d_5": 0.03}, ("axes 3 and 4", "652.3 mm")),
    ],
)
def test_lengths_off_by_tens_of_mm_are_another_arm(change: dict[str, float], words: tuple[str, ...]) -> None:
    found = identified(ur10(), ur10().moved(change))
    assert found.metrics["train"]["identified"]["mean_mm"] < 0.2  # however well it fits
    (message,) = said(found)
    for part in (*words, "not the arm described", "do not activate", "Register the robot"):
        assert part in message, message


def test_a_search_says_the_same() -> None:
    true = ur10().moved({"a_2": 0.052})
    report = find_gap(robot_from_document(ur10().document()), rows(true, 70, 1), QUICK)
    (warning,) = [w for w in report.warnings if w["code"] == CODE]
    assert [warning] == list(another_arm(report.calibration))


@pytest.mark.parametrize("joint", [2, 3, 4])
@pytest.mark.parametrize("degrees", [2.0, pytest.param(-12.0, marks=pytest.mark.slow)])
def test_a_joint_that_was_mastered_wrong_is_the_same_arm(joint: int, degrees: float) -> None:
    true = ur10().moved({f"theta_offset_{joint}": math.radians(degrees)})
    assert said(identified(ur10(), true)) == []


@pytest.mark.parametrize(
    "seed", [0, 1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)]
)
def test_an_arm_made_at_home_is_the_same_arm(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = ur10().moved(table_errors(ur10(), rng, metres=4e-3, radians=1.5e-2))
    assert said(identified(ur10(), true, seed)) == []


@pytest.mark.parametrize("prismatic", [False, True])
@pytest.mark.parametrize("seed", [0, 1, pytest.param(2, marks=pytest.mark.slow)])
def test_arms_of_any_description_with_errors_as_made_are_the_same_arm(seed: int, prismatic: bool) -> None:
    rng = np.random.default_rng([seed, prismatic])
    arm = some_arm(rng, 6, prismatic=prismatic)
    found = identify(robot_from_document(arm.document()), rows(arm.moved(table_errors(arm, rng)), 120, seed))
    assert said(found) == []


def test_no_zero_of_a_joint_and_no_frame_enters() -> None:
    found = identified(ur10(), ur10())
    names = list(found.calibration.names)
    values = found.calibration.values.copy()
    for name in names:
        if name.startswith(("theta_offset", "base", "tool")):
            values[names.index(name)] += 0.5
    assert list(another_arm(replace(found.calibration, values=values))) == []
