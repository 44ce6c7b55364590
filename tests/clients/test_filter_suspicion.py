"""Stated configurations that fit no posture of the robot are a suspicion about the robot, not only about each pose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kilter_client import Kilter

from .answered import document
from .six_joint_arms import Arm
from .test_filter_poses import BASE, LANGUAGES, TOOL, calibrated, taught

FLIPPED = {"RAPID": 3, "KRL": 0}


@pytest.mark.parametrize("name", [*FLIPPED])
def test_signs_by_which_the_configurations_fit_are_named(
    kilter: Kilter, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The program's joints count another way than the robot's: all its poses are left, and the way out is said."""
    one = LANGUAGES[name]
    if f"poses-{one.preset}" not in {found["name"] for found in kilter.robots.list()}:
        calibrated(kilter, one.preset, tmp_path / "measured.csv")
    ideal, q = Arm(one.preset), taught(one.preset, 40, seed=53)
    q = q[np.abs(q[:, FLIPPED[name]]) > 5][:12]
    signs = np.where(np.arange(6) == FLIPPED[name], -1, 1)
    path = tmp_path / f"w{one.ending}"
    poses = np.linalg.inv(BASE) @ np.array([ideal.flange(at) @ TOOL for at in q])
    path.write_text(one.program(q, poses))
    output = ["-o", tmp_path / f"out{one.ending}"]
    told = document(capsys, "filter", path, "--robot", f"poses-{one.preset}", *output)
    assert not any("configurations fit no posture" in note for note in told["notes"])
    path.write_text(one.program(q * signs, poses))
    refused = document(capsys, "filter", path, "--robot", f"poses-{one.preset}", *output, code=1)
    listed = ",".join("-" if sign < 0 else "+" for sign in signs)
    assert (
        f"of 12 stated configurations fit no posture of the robot. They fit with --signs {listed}" in refused["detail"]
    )
    told = document(capsys, "filter", path, "--robot", f"poses-{one.preset}", *output, "--signs", listed)
    assert told["left"] == []
