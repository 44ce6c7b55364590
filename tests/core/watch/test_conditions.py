"""A check under conditions that nobody stated: temperature, set-up and the noise of the day; what moved is still named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.model import Calibration
from kilter_core.watch import Check, Conditions, check, learned_setup
from tests.core.watch.drifting import Floats, set_up_again, some_arm, some_poses, warmed

NOISE = 2e-5
KNOWN = Predictive((), np.zeros((0, 0)), 0.0, NOISE)
UNSTATED = Conditions(within_k=5.0, setup=5e-5, noise_known=False)
STATED = Conditions()
CHECKS = 60


def checks(
    conditions: Conditions, seed: int, count: int = CHECKS, *, kelvin: float = 0.0, setup: float = 0.0,
    noise: float = NOISE, shots: int = 1, change: str = "", size: float = 0.0,
) -> list[Check]:  # fmt: skip
    rng, out = np.random.default_rng(seed), []
    for _ in range(count):
        arm = replace(some_arm(rng), zeros=np.zeros(6), compliance=np.zeros(6))
        calibration = Calibration.nominal(robot_from_document(arm.document()))
        today = arm.after(change, size) if change else arm
        today = set_up_again(warmed(today, rng.uniform(-kelvin, kelvin), rng), setup, rng)
        rows = today.measured(np.repeat(some_poses(6, rng), shots, axis=0), rng, noise)
        out.append(check(calibration, rows, KNOWN, conditions=conditions))
    return out


def alarms(found: list[Check]) -> int:
    return sum(one.verdict != "ok" for one in found)


@pytest.mark.parametrize(
    "today", [{"kelvin": 5.0}, {"setup": 2e-5}, {"noise": 2.2 * NOISE}, {"noise": 2.2 * NOISE, "shots": 3}]
)
def test_what_nobody_stated_is_no_move(today: dict[str, float]) -> None:
    """Rows of 5 K, of a set-up of 20 um and of 2.2 times the noise alarmed in 14, 8 and 4 of 10 to 20 checks."""
    assert alarms(checks(STATED, 1, **today)) >= 10
    assert alarms(checks(UNSTATED, 1, **today)) <= 1


def test_repeated_shots_and_what_is_left_say_how_much_the_rows_scatter() -> None:
    once, thrice = (
        float(np.median([one.scatter for one in checks(UNSTATED, 2, 30, noise=2.2 * NOISE, shots=shots)]))
        for shots in (1, 3)
    )
    assert thrice == pytest.approx(2.2, rel=0.15)
    assert 1.2 < once < 2.6  # the best cause took some of it
    assert {one.scatter for one in checks(STATED, 2, 5)} == {1.0}


@pytest.mark.parametrize("conditions", [STATED, UNSTATED])
@pytest.mark.parametrize(("change", "size"), [("zero_2", 9e-4), ("zero_3", 9e-4), ("zero_5", 9e-4), ("base", 5e-4)])
def test_what_moved_is_named_whatever_was_stated(conditions: Conditions, change: str, size: float) -> None:
    found = checks(conditions, 3, 15, change=change, size=size)
    assert alarms(found) >= 14
    assert all(change in [cause.cause.name for cause in one.causes] for one in found if one.verdict != "ok")
    assert sum(one.verdict == "moved" for one in found) >= 11


def test_two_moves_are_not_one_and_noise() -> None:
    """What the best single cause leaves counts as noise up to three times the version's, and no further."""
    rng = np.random.default_rng(6)
    for _ in range(10):
        arm = replace(some_arm(rng), zeros=np.zeros(6), compliance=np.zeros(6))
        calibration = Calibration.nominal(robot_from_document(arm.document()))
        today = arm.after("zero_3", 4e-3).after("zero_5", 4e-3)
        found = check(calibration, today.measured(some_poses(6, rng), rng, NOISE), KNOWN, conditions=UNSTATED)
        assert (found.verdict, found.causes) == ("cannot_tell", ())


def test_stated_temperatures_leave_nothing_open() -> None:
    rng = np.random.default_rng(4)
    arm = replace(some_arm(rng), zeros=np.zeros(6), compliance=np.zeros(6))
    calibration = Calibration.nominal(robot_from_document(arm.document()))
    rows = arm.measured(some_poses(5, rng), rng, NOISE)
    assert check(calibration, rows, KNOWN, conditions=UNSTATED).conditions.within_k == 5.0
    stated = replace(rows, temperature_c=np.full(5, 21.0))
    assert check(calibration, stated, KNOWN, conditions=UNSTATED).conditions.within_k == 5.0  # the fit says nothing
    both = check(calibration, stated, KNOWN, conditions=UNSTATED, fitted_c=(20.0, 22.0))
    assert both.conditions.within_k == 0.0
    anew = check(calibration, rows, KNOWN, conditions=UNSTATED, new_setup=["base"])
    assert anew.conditions.setup == 0.0


def test_how_well_a_set_up_repeats_is_learned_from_its_checks() -> None:
    rng = np.random.default_rng(5)
    sigmas = np.full((20, 3), 2e-5)

    def learned(sigma: float, count: int) -> float:
        shifts: Floats = 3e-4 + rng.normal(0.0, np.hypot(sigma, 2e-5), (count, 3))
        return learned_setup(shifts, sigmas[:count])

    assert learned_setup(np.zeros((0, 3)), np.zeros((0, 3))) == 5e-5
    assert learned(1e-5, 20) < 3e-5
    assert learned(1.5e-4, 20) == pytest.approx(1.5e-4, rel=0.3)
    assert 2e-5 < learned(0.0, 2) < 6e-5  # two checks say little
