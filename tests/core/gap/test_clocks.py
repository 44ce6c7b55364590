"""Laws that share a clock: that something went with it is one claim, and where it acts is another."""

from __future__ import annotations

import pytest

from kilter_core.arm.run_time import Conditions
from kilter_core.correct.program import at_run_time
from kilter_core.effects import make_effect
from kilter_core.effects.physical import STATION, THERMAL, PhysicalClass, Separator
from kilter_core.gap import GapOptions, GapReport, find_gap
from kilter_core.gap.evidence.separators import Separated
from kilter_core.gap.evidence.verdict import Law, shared_clock
from kilter_core.gap.search.candidates import JOINT, WHOLE, Candidate
from tests.core.gap.time_twins import robot, twin

QUICK = GapOptions(resamples=10, permutations=5, bootstraps=299, next_poses=0)


def corrected(report: GapReport) -> tuple[str, ...]:
    calibration = report.stored.calibration
    return at_run_time(calibration.model, calibration.values, Conditions(temperature_c=30.0)).supported


def test_a_link_that_warms_is_one_motion_with_time() -> None:
    """Its thermometer stands at the base: it was a moving station beside a moving zero of joint 3, and once *closed*."""
    report = find_gap(robot(), twin("link", 1).rows, QUICK)
    (effect,) = report.effects
    assert (effect.evidence.candidate.label, effect.claim.said) == ("link_lengthening j2", "class")
    assert effect.claim.label.startswith("motion with time of base, station, air or arm")
    assert {"drift", "settling", "link_lengthening", "zero_drift"} <= set(effect.claim.members)
    assert corrected(report) == ()
    (parameter,) = effect.evidence.amplitudes
    assert parameter.value == pytest.approx(4e-4, rel=0.2)


def test_air_that_warms_is_no_growth_of_the_arm() -> None:
    """A scale about the station was a `confirmed` drift of the base beside 0.13 mm of growth that would be corrected."""
    report = find_gap(robot(), twin("air", 3).rows, QUICK)
    (effect,) = report.effects
    assert (effect.evidence.candidate.id, effect.claim.said) == ("scale_thermal", "class")
    assert effect.claim.label == "motion with temperature of base, station, air or arm"
    assert not effect.of_arm
    assert corrected(report) == ()
    assert effect.evidence.amplitudes[0].value == pytest.approx(3e-5, rel=0.1)


def test_what_no_member_does_is_one_claim_of_several_laws() -> None:
    """A link that warms and bends: the zero of the next joint was `confirmed` with the temperature beside it."""
    report = find_gap(robot(), twin("bent", 3).rows, QUICK)
    assert len(report.effects) > 1
    assert {j.claim.said for j in report.effects} == {"class"}
    assert len({j.claim.words for j in report.effects}) == 1
    assert report.sentence.count("base, station, air or arm") == 1
    # A cubic of time does not follow the first minutes of a settling: what it left passed for a temperature.
    asked = [e for j in report.effects for e in j.evidence.separated if e.separator is Separator.TEMPERATURE]
    assert not any(e.met for e in asked)
    assert set(corrected(report)) <= {"zero_step"}  # which adds nothing from there on


def law(effect: str, moved: float = 1.0, apart: bool = False, sensed: bool = False, joint: int | None = None) -> Law:
    """A named law with its evidence: a temperature ``apart`` from time, a sensor that shows it."""
    joints = None if joint is None else (joint,)
    evidence = (Separated(Separator.TEMPERATURE, apart), Separated(Separator.SENSOR, sensed))
    made = make_effect(effect, joints)
    return Candidate(effect, joints, (0,), WHOLE if joint is None else JOINT, effects=(made,)), evidence, moved


@pytest.mark.parametrize(
    ("own", "other", "shared"),
    [
        (law("drift"), law("zero_drift", joint=2), STATION),
        (law("thermal_drift", apart=True), law("thermal_growth", apart=True), THERMAL),
        (law("thermal_growth", apart=True), law("drift"), None),
        (law("thermal_growth"), law("drift"), STATION),
        (law("zero_drift", joint=1), law("zero_drift", joint=2), None),
        (law("zero_drift", joint=1), law("drift", sensed=True), None),
        (law("zero_drift", joint=1, sensed=True), law("drift"), None),
        (law("eccentricity", joint=1), law("drift"), None),
        (law("base_step", moved=0.5), law("drift"), STATION),
        (law("base_step", moved=2.0), law("drift"), None),
        (law("drift"), law("base_step"), None),
        (law("base_step"), law("tool_step"), None),
    ],
)  # fmt: skip
def test_two_laws_of_one_clock_are_one_claim(own: Law, other: Law, shared: PhysicalClass | None) -> None:
    assert shared_clock(own, [other]) is shared
    assert shared_clock(own, []) is None
