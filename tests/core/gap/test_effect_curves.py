"""Curves of named effects over what they follow: against plain DH in numpy, which shares no code with the core."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.gap import GapOptions, find_gap
from kilter_core.observations import Observations
from tests.blind.generator import Case, Hidden, Options, generate
from tests.blind.to_core import observations_of, robot_of
from tests.core.gap.sized_twins import JOINT, SMALL, sized
from tests.core.gap.time_twins import BASE, DH, NOISE_M, TOOL, robot, tool_points

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
POSES, REVISITED = 70, 20
LOW, HIGH = np.array([-2.8, -2.2, -2.0, -2.8, -2.5, -2.8]), np.array([2.8, -0.4, 2.0, 2.8, 2.5, 2.8])


def asked(rows: Observations, *effects: str) -> list[dict[str, Any]]:
    quick = GapOptions(resamples=1, permutations=1, bootstraps=199, next_poses=0, effects=effects)
    document = json.loads(json.dumps(find_gap(robot(), rows, quick, validation=0).to_document(), allow_nan=False))
    return list(document["effect_curves"])


def measured(moved: Floats, q: Floats, direction: Floats, pose: Ints, seed: int) -> Observations:
    """Rows of an arm with errors of its geometry whose joints stand at ``q + moved``."""
    rng = np.random.default_rng([seed, 3])
    dh = DH + rng.normal(size=DH.shape) * np.array([1e-3, 3e-4, 3e-4, 1e-3])
    points = tool_points(q + moved, dh, np.tile(TOOL, (len(q), 1))) + BASE
    seen = points + NOISE_M * rng.normal(size=points.shape)
    return Observations(q=q, position=seen, pose_id=pose, direction=direction)


def drawn(seed: int) -> tuple[Floats, Floats, Ints]:
    rng = np.random.default_rng(seed)
    pose = np.concatenate([np.arange(POSES), np.tile(np.arange(REVISITED), 2)])
    return rng.uniform(LOW, HIGH, (POSES, 6))[pose], rng.choice([-1.0, 1.0], (POSES, 6))[pose], pose


def inside(curve: dict[str, Any], truth: Floats) -> float:
    """Share of the visits whose bar holds the truth there, once the truth may have a zero of its own."""
    y, half = np.array(curve["visits"]["y"]), np.array(curve["visits"]["half"])
    offset = np.average(y - truth, weights=half**-2.0)
    return float(np.mean(np.abs(y - truth - offset) <= half))


def test_an_eccentricity_is_drawn_in_degrees_over_the_angle() -> None:
    q, direction, pose = drawn(1)
    moved = np.zeros_like(q)
    moved[:, 2] = 9e-4 * np.sin(q[:, 2]) + 4e-4 * np.cos(q[:, 2])
    (curve,) = asked(
        measured(moved, q, direction, pose, 1), "eccentricity", "encoder_scale", "second_harmonic", "backlash"
    )
    assert [curve[k] for k in ("id", "joint", "follows", "x_unit", "unit")] == ["eccentricity", 3, "q", "deg", "deg"]
    (side,) = curve["sides"]
    x, y, low, high = (np.array(side[k]) for k in ("x", "y", "low", "high"))
    assert (x[0], x[-1]) == (pytest.approx(np.degrees(q[:, 2].min())), pytest.approx(np.degrees(q[:, 2].max())))
    truth = np.degrees(9e-4 * np.sin(np.radians(x)) + 4e-4 * np.cos(np.radians(x)))
    assert np.ptp(y) == pytest.approx(np.ptp(truth), rel=0.05)  # the amplitude, in degrees of the joint
    assert np.mean((low <= truth) & (truth <= high)) > 0.5
    assert np.abs(y - truth).max() < 3 * np.max(high - y)
    here = np.radians(curve["visits"]["x"])
    assert inside(curve, np.degrees(9e-4 * np.sin(here) + 4e-4 * np.cos(here))) > 0.88
    assert len(here) + curve["visits"]["faint"] == curve["visits"]["of"] == len(q)


def test_what_was_refused_is_drawn_where_it_lost() -> None:
    q, direction, pose = drawn(2)
    moved = np.zeros_like(q)
    moved[:, 2] = 9e-4 * np.sin(q[:, 2]) + 4e-4 * np.cos(q[:, 2])
    (curve,) = asked(measured(moved, q, direction, pose, 2), "eccentricity", "encoder_scale")
    rival = curve["rival"]
    assert (rival["id"], rival["joints"]) == ("encoder_scale", [3])
    x, y = (np.array(curve["visits"][k]) for k in ("x", "y"))
    weight = 1.0 / np.array(curve["visits"]["half"])
    slope, offset = np.polyfit(x, y, 1, w=weight)  # a line is the best that a scale error can do
    line = np.array(rival["sides"][0]["y"])
    assert line == pytest.approx(slope * np.array(rival["sides"][0]["x"]) + offset, abs=0.05 * np.ptp(line))
    left = [np.sum((weight * (y - fit)) ** 2) for fit in (slope * x + offset, np.array(curve["visits"]["curve"]))]
    assert rival["times"] == pytest.approx(left[0] / left[1], rel=0.05)
    assert rival["times"] > 5


def test_both_sides_of_a_backlash_are_in_one_picture_with_their_distance() -> None:
    q, direction, pose = drawn(3)
    moved, wide = np.zeros_like(q), 1.2e-3
    moved[:, 1] = wide / 2 * direction[:, 1]
    (curve,) = asked(measured(moved, q, direction, pose, 3), "backlash", "eccentricity", "encoder_scale")
    assert [curve[k] for k in ("id", "joint", "follows", "unit")] == ["backlash", 2, "q", "deg"]
    assert [side["direction"] for side in curve["sides"]] == [1.0, -1.0]
    for side in curve["sides"]:
        assert np.array(side["y"]) == pytest.approx(np.degrees(wide / 2) * side["direction"], rel=0.05)
    distance = curve["distance"]
    assert distance["low"] < np.degrees(wide) < distance["high"]
    assert distance["high"] - distance["low"] < 0.1 * distance["value"]
    assert inside(curve, np.degrees(wide / 2) * np.array(curve["visits"]["direction"])) > 0.88
    assert len(curve["rival"]["sides"]) == 2
    assert curve["rival"]["sides"][0]["y"] == curve["rival"]["sides"][1]["y"]  # a curve of the angle has one side


def test_visits_that_know_the_joint_less_have_longer_bars() -> None:
    q, direction, pose = drawn(4)
    moved = np.zeros_like(q)
    moved[:, 0] = 6e-4 * direction[:, 0]
    curve = next(one for one in asked(measured(moved, q, direction, pose, 4), "backlash") if one["joint"] == 1)
    points = tool_points(q, DH, np.tile(TOOL, (len(q), 1)))
    lever = np.hypot(points[:, 0], points[:, 1])  # from the axis of joint 1
    order = [int(np.argmin(np.abs(np.degrees(q[:, 0]) - x))) for x in curve["visits"]["x"]]
    half = np.array(curve["visits"]["half"])
    wanted = np.degrees(1.96 * NOISE_M / lever[order])
    assert np.median(half / wanted) == pytest.approx(1.0, abs=0.2)
    assert half / wanted == pytest.approx(np.ones(len(half)), rel=0.2)  # the noise is estimated, along each axis
    assert np.ptp(wanted) > 2 * wanted.min()


@pytest.mark.parametrize(
    ("effect", "follows", "unit"), [("zero_drift", "t", "s"), ("zero_thermal", "temperature_c", "degC")]
)
def test_drift_is_drawn_over_time_and_temperature_over_temperature(effect: str, follows: str, unit: str) -> None:
    made = sized(effect, 3, 4.0)
    (curve,) = asked(made.rows, effect)
    assert [curve[k] for k in ("id", "joint", "follows", "x_unit")] == [effect, JOINT + 1, follows, unit]
    (side,) = curve["sides"]
    slope = np.polyfit(side["x"], side["y"], 1)[0]
    assert slope == pytest.approx(np.degrees(4.0 * SMALL[effect][0]), rel=0.1)
    x = np.array(curve["visits"]["x"])
    assert inside(curve, slope * x) > 0.88
    assert side["x"][0] == pytest.approx(0.0 if effect == "zero_drift" else np.min(x), abs=0.1)


def test_a_compliance_is_drawn_over_the_load_moment() -> None:
    """The blind generator has moments and amplitudes of its own."""
    case = Case("load", "katana", (Hidden("axial_compliance", (1,)),), (2500.0,), 60, Options(), "named", 8)
    made = generate(case)
    document = find_gap(
        robot_of(made), observations_of(made.columns),
        GapOptions(resamples=1, permutations=1, bootstraps=199, next_poses=0, effects=("axial_compliance", "backlash")),
        validation=0,
    ).to_document()  # fmt: skip
    curve = next(one for one in document["effect_curves"] if one["joint"] == 2)
    assert [curve[k] for k in ("id", "follows", "x_unit", "unit")] == ["axial_compliance", "axial", "N m", "deg"]
    (truth,) = made.truth.effects[0].parameters.values()
    (side,) = curve["sides"]
    slope, offset = np.polyfit(side["x"], side["y"], 1)
    assert offset == pytest.approx(0.0, abs=1e-6)
    half = (np.array(side["high"]) - side["y"])[-1] / abs(side["x"][-1])
    assert abs(slope - np.degrees(truth)) < 1.5 * half
    assert half < 0.3 * abs(slope)
    assert inside(curve, slope * np.array(curve["visits"]["x"])) > 0.85


def test_what_moves_the_base_has_no_curve_of_a_joint() -> None:
    assert asked(sized("drift", 1, 4.0).rows, "drift") == []
