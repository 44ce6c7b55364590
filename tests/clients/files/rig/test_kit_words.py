"""What `kilter robot kit` says of backlash that is none: a width is never below 0, and neither is what a person reads of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import truncnorm

from kilter_files.rig.kit.coverage import describe_tool_error, result_sentences

JOINTS = [{"name": "pan"}, {"name": "lift"}]


def said(**parameter: Any) -> list[str]:
    return result_sentences(
        {"parameters": [{"name": "backlash_load_2", "unit": "deg", **parameter}]}, JOINTS, [], 0.3, {}
    )


@pytest.mark.parametrize(
    ("parameter", "line"),
    [
        ({"value": 0.5, "sigma": 0.02}, "joint 2 (lift) has 1.0 deg of backlash"),
        ({"value": 0.5, "sigma": 0.2},
         "joint 2 (lift): whether it has backlash is not sure (95 %: 0.22 to 1.78 deg), more views would tell"),
        ({"value": 0.033, "sigma": 0.014},
         "joint 2 (lift): no backlash seen beyond a step of its reading (95 %: 0.01 to 0.12 deg)"),
        ({"value": 0.02, "sigma": 0.1}, "joint 2 (lift): no backlash seen (95 %: 0 to 0.43 deg)"),
        ({"value": -0.02, "sigma": 0.02}, "joint 2 (lift): no backlash seen (95 %: 0 to 0.06 deg)"),
        ({"value": -0.05, "sigma": 0.018}, "joint 2 (lift): no backlash seen (95 %: 0 to 0.03 deg)"),
        ({"value": -0.045, "sigma": 0.001}, "joint 2 (lift): no backlash seen (95 %: below 0.01 deg)"),
        ({"value": -0.02, "sigma": 0.1, "lower": -0.1, "upper": 0.2},
         "joint 2 (lift): no backlash seen (95 %: 0 to 0.40 deg)"),
        ({"value": 0.02, "sigma": None}, "how well the backlash of joint 2 (lift) is known cannot be said"),
        ({"value": -0.5, "sigma": 0.05},
         "joint 2 (lift): no backlash seen; 0.8 to 1.2 deg (95 %) against the load instead: check payload_kg, and that the "
         "robot's base stands upright"),
    ],
)  # fmt: skip
def test_a_width_is_never_below_zero(parameter: dict[str, Any], line: str) -> None:
    assert said(**parameter) == [line]


@pytest.mark.parametrize(
    ("parameter", "stiffness"),
    [
        ({"value": 1.75, "sigma": 0.1}, "33 N m/rad, 95 %: 29 to 37"),
        ({"value": 1.75, "sigma": 0.1, "lower": 1.4, "upper": 2.2}, "33 N m/rad, 95 %: 26 to 41"),
        ({"value": 1.75, "sigma": None}, "33 N m/rad"),
    ],
)
def test_a_sag_says_how_well_its_stiffness_is_known(parameter: dict[str, Any], stiffness: str) -> None:
    found = {"name": "compliance_2", "unit": "deg/(N m)", **parameter}
    (line,) = result_sentences({"parameters": [found]}, JOINTS, [], 0.3, {})
    assert line == f"joint 2 (lift) sags by 1.0 deg more with 200 g held 30 cm away from it ({stiffness})"


def test_what_could_not_be_measured_is_not_told() -> None:
    assert said(value=None, sigma=None) == []


def test_of_a_joint_that_gravity_pulls_one_way_no_backlash_is_told() -> None:
    """Whatever the fit says of it: its prior decided."""
    why = "the backlash of joint 2 (lift) cannot be told from its zero: ..."
    for value, sigma in ((0.5, 0.02), (0.02, 0.1), (-0.5, 0.05)):
        result = {"parameters": [{"name": "backlash_load_2", "unit": "deg", "value": value, "sigma": sigma}]}
        assert result_sentences(result, JOINTS, [], 0.3, {2: why}) == [why]


def test_an_arm_that_is_left_off_by_little_is_not_called_perfect() -> None:
    placed = "(views held out, camera and board where they fit best)"
    assert describe_tool_error(31.94, 0.034) == f"the tool is off by 31.9 mm, corrected by 0.03 mm {placed}"
    assert describe_tool_error(18.5, 0.002) == f"the tool is off by 18.5 mm, corrected by less than 0.01 mm {placed}"
    assert describe_tool_error(None, None).startswith(
        "how far off the tool is elsewhere is not known: no view was held out"
    )
    assert describe_tool_error(31.94, 2.34) == f"the tool is off by 31.9 mm, corrected by 2.3 mm {placed}"


@pytest.mark.parametrize("value", [-0.09, -0.05, -0.02, 0.0])
def test_what_a_joint_could_have_at_most_is_of_a_width_that_cannot_be_negative(value: float) -> None:
    """Against the truncated normal distribution of SciPy; a two-sided interval cut at 0 ended at 0.00 degrees."""
    most = 2.0 * float(truncnorm.ppf(0.95, -value / 0.03, np.inf, loc=value, scale=0.03))
    two_sided = 2.0 * (value + 1.96 * 0.03)
    assert said(value=value, sigma=0.03) == [
        f"joint 2 (lift): no backlash seen (95 %: 0 to {max(most, two_sided):.2f} deg)"
    ]


@pytest.mark.parametrize(
    ("half_deg", "within"), [(0.03, "(95 %: +0.57 to +0.63)"), (0.2, "(95 %: +0.4 to +0.8)")], ids=["narrow", "wide"]
)
def test_the_interval_of_a_zero_has_a_width(half_deg: float, within: str) -> None:
    zero = {"joint": "lift", "offset_deg": 0.6, "half_width_deg": half_deg, "state": "known"}
    (line,) = result_sentences({"parameters": []}, JOINTS, [zero], 0.3, {})
    assert line.startswith(f"the zero of joint 2 (lift) is off by +0.6 deg {within}: 7 ticks (")
