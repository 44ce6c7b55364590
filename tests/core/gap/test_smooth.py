"""Smooth curves of one joint: what a hose or a belt does over less than a turn is no scale error and no eccentricity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.robot import Robot
from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.report.report import GapReport, effect_row
from kilter_core.model import RobotModel
from kilter_core.observations import Observations
from tests.core.gap.simulated import katana

Floats = NDArray[np.float64]
Curve = Callable[[Floats], Floats]

NAMES = ("encoder_scale", "eccentricity", "second_harmonic", "gravity_spring", "backlash")
QUICK = GapOptions(
    effects=(*NAMES, "unknown_smooth_curve"), resamples=20, permutations=5, bootstraps=499, next_poses=0
)  # fmt: skip
JOINT = 1
HALF = np.radians(75.0)
NOISE_M = 2e-5


def measured(robot: Robot, curve: Curve, seed: int, half: float = HALF) -> Observations:
    """Random poses, 25 of them three times; the second joint moves over ``half`` to both sides and errs by ``curve``."""
    rng = np.random.default_rng(seed)
    low, high = np.clip(robot.limits, -2.9, 2.9).T
    low[JOINT], high[JOINT] = -half, half
    pose = np.concatenate([np.arange(90), np.tile(np.arange(25), 2)])
    q = rng.uniform(low, high, (90, robot.n_joints))[pose]
    side = rng.choice([-1.0, 1.0], (90, robot.n_joints))[pose]
    model = RobotModel(robot)
    values = model.values0() + [rng.normal() * (3e-4 if p.unit == "m" else 1e-3) for p in model.parameters]
    true = q.copy()
    true[:, JOINT] += curve(q[:, JOINT])
    position = model.predict(Observations(true), values).position + NOISE_M * rng.standard_normal((len(q), 3))
    return Observations(
        q, position, direction=side, pose_id=pose, t=30.0 * rng.permutation(len(q)), payload_kg=np.zeros(len(q))
    )


def hose(size: float) -> Curve:
    """Torque of a hose that stiffens as it bends, on a compliant joint."""
    return lambda q: size * ((q / HALF) ** 3 - 0.3 * q / HALF)


def rows_of(report: GapReport) -> list[dict[str, object]]:
    return [effect_row(j, report.library, report.misfit) for j in report.effects]


@pytest.mark.parametrize("seed", [pytest.param(k, marks=[pytest.mark.slow] * (k > 2)) for k in range(7)])
def test_the_torque_of_a_hose_gets_no_name_of_its_own(seed: int) -> None:
    robot = katana()
    report = find_gap(robot, measured(robot, hose(3e-4 * 1.3**seed), seed), QUICK)
    claimed = [e for e in rows_of(report) if e["id"] in NAMES]
    assert report.effects
    assert all(e["verdict"] != "confirmed" for e in claimed)
    assert all(e["class"] == "smooth error of joint 2" for e in claimed)
    member = ("unknown_smooth_curve", [2])
    assert all(member in [(a["id"], a["joints"]) for a in e["alias_set"]] for e in claimed)


@pytest.mark.parametrize("turns", [0.6, 1.37])
def test_a_belt_is_no_eccentricity(turns: float) -> None:
    robot = katana()
    report = find_gap(robot, measured(robot, lambda q: 4e-4 * np.sin(turns * q + 0.4), 3), QUICK)
    assert report.effects
    assert all(j.verdict != "confirmed" for j in report.effects)


def test_over_a_turn_and_more_a_curve_keeps_its_name() -> None:
    robot = katana()
    rows = measured(robot, lambda q: 4e-4 * np.sin(q) + 3e-4 * np.cos(q), 6, half=1.1 * np.pi)
    (effect,) = rows_of(
        find_gap(robot, rows, replace(QUICK, effects=("eccentricity", "backlash", "unknown_smooth_curve")))
    )
    assert (effect["id"], effect["joints"], effect["verdict"], effect["class"]) == (
        "eccentricity",
        [2],
        "confirmed",
        None,
    )


def test_a_clear_shape_below_a_turn_is_said_of_the_class_with_its_shape() -> None:
    robot = katana()
    rows = measured(robot, lambda q: 8e-3 * np.sin(q) + 8e-3 * np.cos(q), 6)
    names = rows_of(find_gap(robot, rows, replace(QUICK, effects=("eccentricity", "backlash", "unknown_smooth_curve"))))
    said = "error curve of joint 2, in the shape of eccentricity"
    assert [(e["id"], e["verdict"], e["class"], e["claim"]["words"]) for e in names] == [
        ("eccentricity", "class_confirmed", said, said)
    ]
    assert names[0]["physical_class"]["label"] == "error curve of joint 2"
    assert "belt" in names[0]["physical_class"]["outside"]
    (asked,) = names[0]["claim"]["evidence"]
    assert (asked["name"], asked["met"]) == ("turn", False)
    assert asked["number"] == pytest.approx(150.0 / 360.0, rel=0.05)


@pytest.mark.parametrize("seed", range(4))
def test_a_nearly_straight_curve_is_never_a_scale(seed: int) -> None:
    """A belt or a hose that pulls almost evenly: the only rival with one parameter is the straight line itself."""
    robot = katana()
    rows = measured(robot, lambda q: 6e-4 * (q + 0.06 * (seed - 1.5) * q**2), seed)
    (effect,) = rows_of(find_gap(robot, rows, replace(QUICK, effects=("encoder_scale", "backlash"))))
    assert (effect["id"], effect["class"]) == ("encoder_scale", "smooth error of joint 2")
    assert effect["claim"]["said"] == "class"
    assert effect["verdict"] in ("class_confirmed", "provisional")
