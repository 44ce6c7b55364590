"""Since when an arm has moved: no later than its rows, and no day of a check that could not have seen it."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import httpx
import numpy as np

from kilter_service.ground.db import Database
from kilter_service.versions.drift.wire import StoredCheck, last_otherwise
from tests.core.watch.drifting import some_arm
from tests.service.watched_robot import DAY, Watched


def test_a_check_that_could_not_see_it_says_nothing_of_when(client: httpx.Client, database: Database) -> None:
    arm = some_arm(np.random.default_rng(3))
    robot = Watched(client, None, arm, "coarse")
    robot.calibrated(database)
    for day in (1, 3):
        assert robot.checked_here(database, arm, 100 + day, day)["verdict"] == "ok"
    moved = arm.after("zero_2", 1.5e-3)
    rows = robot.sent(moved, 6, 105, DAY + timedelta(days=5))
    assert robot.done_here(database, "drift", [rows], noise_mm=1.0)["verdict"] == "ok"  # by a coarser instrument
    found = robot.checked_here(database, moved, 106, 6)
    assert found["verdict"] == "moved"
    assert " since 2026-09-04." in found["sentence"]
    assert found["agreed_at"].startswith("2026-09-04")
    # Sent late: measured before the arm agreed again, so not since then.
    assert robot.checked_here(database, arm, 120, 20)["verdict"] == "ok"
    late = robot.checked_here(database, moved, 107, 7)
    assert " since 2026-09-04." in late["sentence"]


def check(day: int, change: float, u95: float, **more: Any) -> StoredCheck:
    number = {"name": "value", "unit": "deg", "change": change, "u95": u95}
    looked = [{"name": "zero_2", "words": "zero of joint 2", "numbers": [number]}]
    return StoredCheck(f"job_{day}", "cmp", DAY + timedelta(days=day), {"verdict": "ok", "looked_at": looked, **more})


def test_what_came_little_by_little_began_before_the_last_check_that_agreed() -> None:
    ramp = [check(day, 0.001 * day, 0.01) for day in range(30)]
    (now,) = check(30, 0.03, 0.01).result["looked_at"]
    assert last_otherwise([now], 0.05, 6, ramp) == DAY + timedelta(days=15)  # 0.015 deg: apart by more than 0.0141
    assert last_otherwise([now], 0.05, 6, ramp[16:]) is None
    other = {**now, "name": "zero_3"}  # of which no check says anything
    assert last_otherwise([now, other], 0.05, 6, ramp) is None


def test_of_several_changes_a_check_counts_that_saw_as_much() -> None:
    fine, coarse, few = (check(day, 0.0, 0.01, noise_mm=noise, poses=poses)
                         for day, noise, poses in ((1, 0.05, 6), (2, 0.5, 6), (3, 0.05, 3)))  # fmt: skip
    assert last_otherwise([], 0.05, 6, [fine, coarse, few]) == fine.at
