"""`--robot.type=kilter_so101` in LeRobot's own Python, on LeRobot's own bus, against simulated servos: `tools.lab lerobot`."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kilter_client import Kilter
from tests.clients.files.formats.test_lerobot import RANGES, calibration
from tests.clients.lerobot.so101_arm import JOINTS, Floats, tool_mm

ENVIRONMENT = Path(os.environ.get("KILTER_LEROBOT", "/nowhere"))
pytestmark = [
    pytest.mark.lerobot,
    pytest.mark.skipif(
        not (ENVIRONMENT / "bin" / "python").exists(),
        reason="no environment with LeRobot: `python -m tools.lab lerobot` installs it beside",
    ),
]

TICK = 360.0 / 4095.0
ERRORS = {"elbow_flex_x": 1.5, "wrist_flex_y": -1.0}  # mm
ZEROS = np.array([0.0, 1.4, -0.9, 0.6, 0.0])  # real less reading, degrees
POSES = np.array([[10.0, -20.0, 30.0, 15.0, 5.0], [-25.0, 15.0, -10.0, -30.0, 40.0], [5.0, -45.0, 50.0, 20.0, -60.0]])
GRIPPER = 37.0


def measured(k: Kilter, name: str, folder: Path, servos: Path | None) -> None:
    """Calibrate an arm whose zeros and links are off; the version is active."""
    k.robots.add({"name": name, "convention": "preset", "preset": "so101", "controller_compensation": "none"})
    q = np.random.default_rng(4).uniform(-1, 1, (60, 5)) * [100, 90, 90, 90, 150]
    seen = np.array([tool_mm(row + ZEROS, ERRORS) for row in q]) + np.random.default_rng(5).normal(0, 0.02, (60, 3))
    head = ",".join([*(f"q{j}_deg" for j in range(1, 6)), "x_mm", "y_mm", "z_mm"])
    np.savetxt(folder / "rows.csv", np.hstack([q, seen]), delimiter=",", header=head, comments="", fmt="%.10g")
    from kilter_client.cli import run

    stated = [] if servos is None else ["--calibration", str(servos)]
    assert run(["upload", name, str(folder / "rows.csv"), "--name", "first", *stated]) == 0
    assert run(["identify", name, "-c", "first", "--level", "2", "--base", "fixed", "--tool", "fixed"]) == 0
    assert run(["activate", "latest", "--robot", name, "--force"]) == 0


def run_follower(server: Path, folder: Path, servos: Path, options: list[str], **asked: Any) -> dict[str, Any]:
    given = {"options": options, "calibration": str(servos), "actions": [], **asked}
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("KILTER_", "PYTHON"))}
    environment |= {
        "KILTER_DATA": str(server), "HF_HOME": str(folder / "hf"), "NUMBA_CACHE_DIR": "build/kernels-lerobot",
        "HF_LEROBOT_CALIBRATION": str(folder / "calibration"), "CUDA_VISIBLE_DEVICES": "",
    }  # fmt: skip
    done = subprocess.run(
        [str(ENVIRONMENT / "bin/python"), str(Path(__file__).with_name("run_follower.py"))], input=json.dumps(given),
        env=environment, capture_output=True, text=True, timeout=280, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-4000:]
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def action_of(pose: Floats, by_range: bool) -> dict[str, float]:
    half = [(high - low) / 2 * TICK for low, high in RANGES[:5]]
    told = {f"{j}.pos": 100 * a / h if by_range else a for j, a, h in zip(JOINTS, pose, half, strict=True)}
    return told | {"gripper.pos": GRIPPER}


def degrees_of(numbers: dict[str, float], by_range: bool) -> Floats:
    half = np.array([(high - low) / 2 * TICK for low, high in RANGES[:5]])
    told = np.array([numbers[f"{joint}.pos"] for joint in JOINTS])
    return told / 100 * half if by_range else told


def real_of(goals: dict[str, int]) -> Floats:
    """Real joints of an arm whose servos are at these ticks, degrees."""
    middle = np.array([(low + high) / 2 for low, high in RANGES[:5]])
    return (np.array([goals[joint] for joint in JOINTS]) - middle) * TICK + ZEROS


@pytest.mark.parametrize("by_range", [False, True])
def test_the_arm_goes_where_it_is_told_and_says_where_it_is(
    kilter: Kilter, server: Path, tmp_path: Path, by_range: bool
) -> None:
    folder = tmp_path / "calibration/robots/so_follower"
    servos = calibration(folder)
    name = f"follower-{by_range}"
    measured(kilter, name, tmp_path, servos)
    degrees = str(not by_range).lower()
    options = ["--robot.type=kilter_so101", "--robot.id=my_arm"]
    options += [f"--robot.kilter_robot={name}", f"--robot.use_degrees={degrees}"]
    actions = [action_of(pose, by_range) for pose in POSES]
    told = run_follower(server, tmp_path, servos, options, actions=actions, steps=not by_range, robot=name)
    assert "refused" not in told, told
    assert (told["type"], told["robot_type"]) == ("kilter_so101", "kilter_so101")
    assert told["features"] == sorted([*(f"{joint}.pos" for joint in JOINTS), "gripper.pos"])
    assert told["state"]["state"] == "correcting"
    assert told["state"]["refused"] == {}
    for pose, seen in zip(POSES, told["seen"], strict=True):
        wanted = tool_mm(pose)
        uncorrected = tool_mm(np.round(pose / TICK) * TICK + ZEROS, ERRORS)
        assert np.linalg.norm(uncorrected - wanted) > 3.0
        # Five joints to the nearest tick: at most half of one each, a third of a millimetre at 0.4 m.
        assert np.linalg.norm(tool_mm(real_of(seen["goals"]), ERRORS) - wanted) < 0.6
        assert np.abs(degrees_of(seen["sent"], by_range) - pose).max() < 1e-6
        # What it observes is what it was told, but for ticks and for the wrist, with which the tool point is reached.
        assert np.linalg.norm(tool_mm(degrees_of(seen["observed"], by_range)) - wanted) < 0.6
        assert seen["observed"]["gripper.pos"] == pytest.approx(GRIPPER, abs=0.1)
        assert seen["sent"]["gripper.pos"] == GRIPPER
    if not by_range:
        assert_steps(told, actions)


def assert_steps(told: dict[str, Any], actions: list[dict[str, float]]) -> None:
    """Steps do what the follower does, and are made again with the version they had."""
    by_steps = told["steps"]
    first = real_of({joint: round(by_steps["action"][f"{joint}.pos"] / TICK - 0.5 + (low + high) / 2)
                     for joint, (low, high) in zip(JOINTS, RANGES, strict=False)})  # fmt: skip
    assert np.linalg.norm(tool_mm(first, ERRORS) - tool_mm(POSES[0])) < 0.6
    last = degrees_of(by_steps["observation"], False)
    assert np.linalg.norm(tool_mm(last) - tool_mm(POSES[-1])) < 0.6
    assert by_steps["config"]["version"] == told["state"]["version_id"]
    assert by_steps["action"]["gripper.pos"] == GRIPPER


def test_another_calibration_is_refused_before_anything_moves(kilter: Kilter, server: Path, tmp_path: Path) -> None:
    servos = calibration(tmp_path / "calibration/robots/so_follower")
    measured(kilter, "other-zeros", tmp_path, servos)
    options = ["--robot.type=kilter_so101", "--robot.id=my_arm", "--robot.kilter_robot=other-zeros"]
    servos.write_text(servos.read_text().replace("-200", "-199"))
    told = run_follower(server, tmp_path, servos, options)
    assert told["code"] == "calibration_differs"
    assert "my_arm.json: its SHA-256 is " in told["refused"]
    assert "with other zeros it is another arm" in told["refused"]
    assert told["torque"] == [0] * 6
    gone = run_follower(server, tmp_path, servos, [options[0], "--robot.id=nobody", options[2]])
    assert "nobody.json: is missing. Give --robot.id" in gone["refused"]
    unnamed = run_follower(server, tmp_path, servos, options[:2])
    assert "Say which robot of the Kilter server this arm is" in unnamed["refused"]


def test_a_version_whose_campaign_states_no_calibration_is_refused(
    kilter: Kilter, server: Path, tmp_path: Path
) -> None:
    servos = calibration(tmp_path / "calibration/robots/so_follower")
    measured(kilter, "unstated-zeros", tmp_path, None)
    told = run_follower(
        server,
        tmp_path,
        servos,
        ["--robot.type=kilter_so101", "--robot.id=my_arm", "--robot.kilter_robot=unstated-zeros"],
    )
    assert "does not state with which calibration of the servos it was measured" in told["refused"]
    assert told["torque"] == [0] * 6
