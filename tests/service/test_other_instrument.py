"""Checks by an instrument that the version was not fitted to count as that makes them."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import httpx
import numpy as np

from kilter_service.ground.db import Database
from tests.core.watch.drifting import DriftingArm, some_arm, some_poses
from tests.service.test_budgets import TRACKER
from tests.service.watched_robot import DAY, Watched

COARSE = 4e-4  # m, standard deviation of a coordinate
ARM_CMM = {"name": "arm-cmm", "kind": "arm_cmm", "serial_number": "2", "mpe_um": 700.0}


def sent(robot: Watched, arm: DriftingArm, seed: int, day: int, noise: float, instrument: str, poses: int = 6) -> str:
    rng = np.random.default_rng(seed)
    q = some_poses(poses, rng)
    seen = arm.measured(q, rng, noise).position
    assert seen is not None
    at = DAY + timedelta(days=day)
    body = {"name": f"{instrument}-{day}", "role": "validation" if poses < 20 else "train", "numbered": True,
            "measured_at": at.isoformat(), "instrument": instrument}  # fmt: skip
    made = robot.client.post(f"/v1/robots/{robot.name}/campaigns", json=body).raise_for_status().json()["id"]
    columns = {f"q{k + 1}_deg": np.degrees(q[:, k]).tolist() for k in range(6)}
    columns |= {f"{axis}_mm": (seen[:, k] * 1e3).tolist() for k, axis in enumerate("xyz")}
    robot.client.post(f"/v1/campaigns/{made}/observations", json=columns).raise_for_status()
    return str(made)


def test_a_coarser_instrument_is_no_arm_that_moved(client: httpx.Client, database: Database) -> None:
    for one in (TRACKER, ARM_CMM):
        client.post("/v1/instruments", json=one).raise_for_status()
    arm = some_arm(np.random.default_rng(3))
    robot = Watched(client, None, arm, "instruments")
    effects = [{"id": "axial_compliance", "joints": [2, 3]}]
    fit = sent(robot, arm, 1, -1, 5e-5, "tracker", 60)
    made = robot.done_here(database, "identify", [fit], effects=effects, masses="as_stated")["version_id"]
    robot.activated(made)

    def checked(moved: DriftingArm, seed: int, noise: float, instrument: str, **options: Any) -> dict[str, Any]:
        return robot.done_here(database, "drift", [sent(robot, moved, seed, seed, noise, instrument)], **options)

    same = checked(arm, 2, 5e-5, "tracker")
    assert (same["verdict"], [one["code"] for one in same["warnings"]]) == ("ok", [])
    for seed in range(3, 7):
        found = checked(arm, seed, COARSE, "arm-cmm")
        assert found["verdict"] == "ok", found["sentence"]
        assert 0.39 < found["noise_mm"] < 0.42  # 0.7 mm, as likely anywhere within
        (remark,) = found["warnings"]
        assert remark["code"] == "another_instrument"
        assert "was measured with arm-cmm, which the version was not fitted to" in remark["message"]
    assert checked(arm, 8, COARSE, "arm-cmm", noise_mm=0.05)["verdict"] != "ok"  # stated, so it counts
    assert checked(arm.after("zero_2", 1e-2), 9, COARSE, "arm-cmm")["verdict"] != "ok"
