"""`kilter try`: a file and a robot in, one page out; a server of its own that is gone afterwards."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from kilter_client.cli import run, trial
from kilter_client.requests.connection import local_server
from tests.clients.three_joint_arm import arm, tip_mm
from tests.service.forked import ForkedPopen

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


def test_a_file_and_a_robot_become_one_page_without_a_server(tmp_path: Path) -> None:
    rows, robot = measured(tmp_path)
    plain = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
    command = [Path(sys.executable).with_name("kilter"), "try", rows, "--robot", robot, "--json", "-o", "trial.html"]
    done = subprocess.run(command, cwd=tmp_path, env=plain | {"HOME": str(tmp_path)}, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    found = json.loads(done.stdout)
    assert set(found) == {"report", "identify", "gap"}
    after = found["identify"]["result"]["metrics"]["validation"]
    assert after["identified"]["mean_mm"] < 0.1 < after["nominal"]["mean_mm"]
    page = (tmp_path / "trial.html").read_text(encoding="utf-8")
    assert "<style>" in page
    assert not re.findall(r"(?:href|src)=\"(?!#|https?:|mailto:|data:)", page)  # it needs no other file
    assert not (tmp_path / ".kilter").exists()


def test_a_trial_that_cannot_go_on_says_why_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rows, _ = measured(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(trial, "local_server", partial(local_server, start=ForkedPopen))
    assert run(["try", str(rows), "--robot", "nobodys-preset"]) == 1
    assert "nobodys-preset" in capsys.readouterr().err
    assert sorted(one.name for one in tmp_path.iterdir()) == ["arm.json", "measured.csv"]
