"""`kilter check` of a joint log alone, as a user sends it: a ball seated in one socket by some poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kilter_client import Kilter
from tests.clients.test_cli import Command
from tests.core.watch.drifting import DriftingArm
from tests.core.watch.test_sockets import TENTH, perfect, seated


def tracked(arm: DriftingArm, rng: np.random.Generator, path: Path, rows: int) -> Path:
    q = rng.uniform(-1.5, 1.5, (rows, 6))
    seen = 1e3 * np.array([arm.point(one) for one in q]) + rng.normal(0.0, 0.02, (rows, 3))
    head = ",".join([*(f"q{k}_deg" for k in range(1, 7)), "x_mm", "y_mm", "z_mm"])
    np.savetxt(path, np.hstack([np.degrees(q), seen]), delimiter=",", header=head, comments="", fmt="%.9g")
    return path


def log(arm: DriftingArm, rng: np.random.Generator, path: Path, poses: int = 8) -> Path:
    rows = seated(arm, poses, rng)
    assert rows.socket is not None
    head = ",".join([*(f"q{k}_deg" for k in range(1, 7)), "socket_id"])
    table = np.column_stack([np.degrees(rows.q), rows.socket])
    np.savetxt(path, table, delimiter=",", header=head, comments="", fmt="%.9g")
    return path


def test_a_log_of_a_seated_ball_is_a_check_by_command(k: Kilter, command: Command, tmp_path: Path) -> None:
    arm, _, rng = perfect(0)
    k.add_robot({**arm.document(), "name": "seated", "controller_compensation": "none"})
    made = k.identify(
        "seated", k.upload("seated", tracked(arm, rng, tmp_path / "tracked.csv", 60), progress=False),
        validation=0.3, level=1, progress=False,
    )  # fmt: skip
    command("activate", made.version_id, "--robot", "seated", "--force")
    before = k.today("seated")
    well = command.json("check", "seated", log(arm, rng, tmp_path / "well.csv"), "--noise-mm", "0.02")["result"]
    assert well["verdict"] == "ok", well["sentence"]
    assert any(one.startswith("zero of joint 1") for one in well["unseen"]), well["unseen"]
    moved = log(arm.after("zero_3", 3.0 * TENTH), rng, tmp_path / "off.csv")
    off = command.json("check", "seated", moved, "--noise-mm", "0.02", code=3)["result"]
    assert off["verdict"] == "moved"
    assert [one["joint"] for one in off["causes"]] == [3], off["causes"]
    (number,) = off["causes"][0]["numbers"]
    assert abs(number["change"] - 0.3) < number["u95"] < 0.1
    # The scatter of a ball in its socket is no error of the tool, and no number of today.
    assert well["joint_log"] is True
    after = k.today("seated")
    assert after.newest.job_id == before.newest.job_id
    few = command.json("check", "seated", log(arm, rng, tmp_path / "few.csv", 3), "--noise-mm", "0.02", code=1)
    assert few["code"] == "too_few_poses"
    assert "Seat the ball in one socket by six poses" in few["detail"]
    unstated = command.json("check", "seated", log(arm, rng, tmp_path / "unstated.csv"), code=1)
    assert "does not say how well it sits" in unstated["detail"]
