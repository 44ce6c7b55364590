"""An arm of which nobody knows how warm it is may be warmer than at its fit: a check says so where that explains the rows."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta

import httpx
import numpy as np

from kilter_service.ground.db import Database
from tests.core.watch.drifting import some_arm
from tests.service.watched_robot import DAY, Watched

WARMER_K = 14.0
EITHER = "An arm 10 K warmer or colder than at its fit may show as much, too: nobody stated both temperatures."


def test_a_warm_arm_without_its_temperature_is_not_said_to_have_moved_alone(
    client: httpx.Client, database: Database
) -> None:
    arm = some_arm(np.random.default_rng(3))
    robot = Watched(client, None, arm, "warm")
    robot.calibrated(database, temperature_c=23.0)
    grown = 1.0 + 12e-6 * WARMER_K
    warm = replace(
        arm, rows=arm.rows * np.array([grown, grown, 1.0]), zeros=arm.zeros + 4e-6 * WARMER_K * np.sign(arm.zeros)
    )
    unstated = robot.done_here(database, "drift", [robot.sent(warm, 20, 300, DAY + timedelta(days=3))])
    assert unstated["verdict"] != "ok"
    assert EITHER in unstated["sentence"]
    assert unstated["remedy"].startswith("State temperature_c of these rows")
    rows = robot.sent(warm, 20, 301, DAY + timedelta(days=4), temperature_c=37.0)
    stated = robot.done_here(database, "drift", [rows])
    assert (stated["verdict"], EITHER in stated["sentence"]) == ("ok", False)
    crashed = robot.checked_here(database, arm.after("zero_3", 4e-3), 302, 5)
    assert (crashed["verdict"], EITHER in crashed["sentence"]) == ("moved", False)
