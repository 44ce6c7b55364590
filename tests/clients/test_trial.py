"""`kilter try`: a file and a robot in, one page out; a server of its own that is gone afterwards."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np

from tests.clients.three_joint_arm import arm, tip_mm

OFFSET_DEG = 0.3  # of the second joint's zero, which the search has to find


def measured(folder: Path) -> tuple[Path, Path]:
    rng = np.random.default_rng(7)
    q_deg = rng.uniform(-80, 80, (40, 3))
    tip = tip_mm(q_deg + np.array([0.0, OFFSET_DEG, 0.0])) + rng.normal(0.0, 0.02, (40, 3))
    rows, robot = folder / "measured.csv", folder / "arm.json"
    head = "q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm"
    np.savetxt(rows, np.hstack([q_deg, tip]), delimiter=",", header=head, comments="", fmt="%.9g")
    robot.write_text(json.dumps(arm("other-name")), encoding="utf-8")
    return rows, robot


def run_trial(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    plain = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
    program = Path(sys.executable).with_name("kilter")
    return subprocess.run(
        [program, "try", *arguments],
        cwd=folder,
        env=plain | {"HOME": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_file_and_a_robot_become_one_page_without_a_server(tmp_path: Path) -> None:
    rows, robot = measured(tmp_path)
    done = run_trial(tmp_path, str(rows), "--robot", str(robot), "--json", "-o", "trial.html")
    assert (done.returncode, done.stderr) == (0, "")
    found = json.loads(done.stdout)
    assert set(found) == {"report", "identify", "gap"}
    after = found["identify"]["result"]["metrics"]["validation"]
    assert after["identified"]["mean_mm"] < 0.1 < after["nominal"]["mean_mm"]
    page = (tmp_path / "trial.html").read_text(encoding="utf-8")
    assert "<style>" in page
    assert not re.findall(r"(?:href|src)=\"(?!#|https?:|mailto:|data:)", page)  # it needs no other file
    assert not (tmp_path / ".kilter").exists()


def test_a_trial_that_cannot_go_on_says_why_and_leaves_nothing(tmp_path: Path) -> None:
    rows, _ = measured(tmp_path)
    done = run_trial(tmp_path, str(rows), "--robot", "nobodys-preset")
    assert done.returncode == 1
    assert "nobodys-preset" in done.stderr
    assert sorted(one.name for one in tmp_path.iterdir()) == ["arm.json", "measured.csv"]
