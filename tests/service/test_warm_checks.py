"""An arm of which nobody knows how warm it is may be warmer than at its fit: a check allows for that, and says how far."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta

import httpx
import numpy as np
import pytest

from kilter_service.ground.db import Database
from tests.core.watch.drifting import set_up_again, some_arm, warmed
from tests.service.watched_robot import DAY, Watched

WARMER_K = 5.0
WITHIN = "This holds if the arm was within 5 K of its temperature at the fit"


def test_an_arm_whose_temperature_nobody_stated_may_be_warm(client: httpx.Client, database: Database) -> None:
    arm = some_arm(np.random.default_rng(3))
    robot = Watched(client, None, arm, "warm")
    robot.calibrated(database, temperature_c=23.0)
    grown = 1.0 + 12e-6 * WARMER_K
    warm = replace(
        arm, rows=arm.rows * np.array([grown, grown, 1.0]), zeros=arm.zeros + 4e-6 * WARMER_K * np.sign(arm.zeros)
    )
    unstated = robot.done_here(database, "drift", [robot.sent(warm, 20, 300, DAY + timedelta(days=3))])
    assert unstated["verdict"] == "ok"
    assert f"{WITHIN} and the set-up repeats to" in unstated["sentence"]
    assert (unstated["within_k"], unstated["scatter"] < 1.5) == (5.0, True)
    rows = robot.sent(warm, 20, 301, DAY + timedelta(days=4), temperature_c=28.0)
    stated = robot.done_here(database, "drift", [rows], setup_mm=0.0)
    assert (stated["verdict"], "This holds" in stated["sentence"]) == ("ok", False)
    assert (stated["within_k"], stated["setup_mm"]) == (0.0, 0.0)
    crashed = robot.checked_here(database, arm.after("zero_3", 4e-3), 302, 5)
    assert crashed["verdict"] == "moved"
    assert WITHIN in crashed["sentence"]
    assert crashed["remedy"].startswith("Repair it and check again")
    both = robot.checked_here(database, arm.after("zero_3", 4e-3).after("zero_5", 4e-3), 303, 6)
    assert both["verdict"] == "cannot_tell"
    assert both["remedy"].startswith("State temperature_c of these rows")


@pytest.mark.parametrize(("kelvin", "setup"), [(0.0, 5e-5), (4.0, 2e-5)])
def test_a_month_of_checks_of_which_nothing_is_stated(
    client: httpx.Client, database: Database, kelvin: float, setup: float
) -> None:
    """The set-up of each day is learned from the days before; then a zero of 0.1 deg is moved, and it alone is named."""
    rng = np.random.default_rng(11)
    robot = Watched(client, None, some_arm(rng), "month")
    robot.calibrated(database)
    found = []
    for day in range(30):
        arm = robot.arm if day < 25 else robot.arm.after("zero_3", 1.8e-3)
        today = set_up_again(warmed(arm, float(rng.uniform(-kelvin, kelvin)), rng), setup, rng)
        found.append(robot.checked_here(database, today, 400 + day, day))
    assert [one["verdict"] for one in found[:25]].count("ok") == 25
    assert [one["verdict"] for one in found[25:]].count("ok") == 0
    named = [cause["name"] for one in found[25:] if one["verdict"] == "moved" for cause in one["causes"]]
    assert set(named) == {"zero_3"}
