"""A sensor at the place bears a name out, or refutes it: its readings are made by the twins' own truth."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

from kilter_core.effects.physical import Separator
from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.evidence.separators import Separated
from kilter_core.observations import Observations
from tests.core.gap.time_twins import robot, twin

QUICK = GapOptions(resamples=2, permutations=2, bootstraps=299, next_poses=0)


def sensor(rows: Observations, effect: str) -> tuple[Any, Separated | None]:
    """The first effect that a search names, and what a sensor says of it."""
    judged = find_gap(robot(), rows, replace(QUICK, effects=(effect,))).effects[0]
    return judged, next((e for e in judged.claim.evidence if e.separator is Separator.SENSOR), None)


def test_an_inclinometer_that_does_not_see_the_tilt_refutes_it_with_both_numbers():
    judged, said = sensor(twin("climbing", 3).with_inclinometer(0.0), "drift")
    assert said is not None
    assert (said.met, said.against) == (False, True)
    assert judged.verdict == "provisional"
    assert not judged.gates["sensor"]
    assert abs(judged.numbers["sensor"]) < 3.0
    shown, expected = re.findall(r"([-\d.]+) ± [\d.]+ deg", judged.claim.words)
    assert abs(float(shown)) < 0.05 * float(expected)
    assert "the inclinometer on the base shows" in judged.claim.words
    assert "the height of the tool rose with the clock" in judged.claim.words


def test_one_that_sees_it_names_the_motion_whatever_the_order():
    """The base itself climbed with the clock: no pose was revisited, but the sensor is at the place."""
    made = twin("climbing", 3)
    judged, said = sensor(made.with_inclinometer(1.0), "drift")
    assert said is not None
    assert said.met
    assert judged.gates["sensor"]
    assert "whatever" not in judged.claim.words
    assert "shows" in said.told


def test_a_station_that_moved_beside_a_level_base_is_the_instrument():
    """Revisits show that something moved with time, and the inclinometer that it was not the base."""
    judged, said = sensor(twin("base", 3).with_inclinometer(0.0), "base_step")
    assert said is not None
    assert said.against
    assert judged.claim.said == "class"
    assert "the inclinometer on the base shows" in judged.claim.words
    assert judged.gates["sensor"]


def test_a_step_that_tilts_the_base_is_seen_by_its_inclinometer():
    judged, said = sensor(twin("base", 4).with_inclinometer(1.0), "base_step")
    assert judged.evidence.candidate.id == "base_step"
    assert said is not None
    assert said.met


def test_a_link_encoder_bears_out_a_zero_that_moved():
    made = twin("zero_drift", 3)
    _, said = sensor(made.with_link_encoders(1.0), "zero_drift")
    assert said is not None
    assert said.met
    assert f"the link encoder of joint {made.joint + 1} shows 0.0" in said.told
    alone, _ = sensor(made.with_inclinometer(0.0), "zero_drift")
    assert "sensor" not in alone.gates  # an inclinometer on the base reads no joint
