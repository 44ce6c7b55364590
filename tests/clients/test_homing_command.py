"""`kilter robot homing`: an arm of simulated servos that reads what it should once the copy is in them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kilter_client import Kilter
from kilter_client.errors import FileError
from kilter_files.formats.joints.lerobot.calibration import read_calibration, with_zero_offsets
from tests.clients.test_cli import Command

JOINTS = ("j1", "j2", "j3")
ZEROS_DEG = (1.5, -0.9, 0.4)  # real less reading
TICK = 360.0 / 4095.0
ARM: dict[str, Any] = {
    "convention": "dh", "joints": [{"name": name, "limits_deg": [-100, 100]} for name in JOINTS],
    "rows": [
        {"type": "revolute", "theta_offset_deg": 0, "d_mm": 60, "a_mm": 20, "alpha_deg": 90},
        {"type": "revolute", "theta_offset_deg": 0, "d_mm": 0, "a_mm": 116, "alpha_deg": 0},
        {"type": "revolute", "theta_offset_deg": 0, "d_mm": 0, "a_mm": 235, "alpha_deg": 0},
    ],
    "tool": {"x_mm": 10, "y_mm": 5, "z_mm": 30, "rx_deg": 0, "ry_deg": 0, "rz_deg": 0},
}  # fmt: skip


def calibration(folder: Path, **changes: dict[str, int]) -> Path:
    servos = {
        name: {"id": j + 1, "drive_mode": 0, "homing_offset": 30 - 20 * j, "range_min": 900, "range_max": 3150 + 2 * j}
        for j, name in enumerate(JOINTS)
    }
    for name, change in changes.items():
        servos[name] |= change
    folder.mkdir(exist_ok=True)
    path = folder / "my_arm.json"
    path.write_text(json.dumps(servos, indent=4))
    return path


def reading(raw: int, servo: dict[str, int], maker: str, mode: str) -> float:
    """What LeRobot makes of a servo's own ticks, in degrees from the middle of the range."""
    present = raw - servo["homing_offset"] if maker == "feetech" else raw + servo["homing_offset"]
    low, high = servo["range_min"], servo["range_max"]
    if mode == "DEGREES":
        return (present - (low + high) / 2) * TICK
    part = (present - low) / (high - low) * 200.0 - 100.0
    return (-part if servo["drive_mode"] else part) / 100.0 * (high - low) / 2 * TICK


@pytest.mark.parametrize("maker", ["feetech", "dynamixel"])
@pytest.mark.parametrize("mode", ["DEGREES", "RANGE_M100_100"])
@pytest.mark.parametrize("reversed_", [0, 1])
def test_a_servo_reads_the_real_angle_to_half_a_tick(tmp_path: Path, maker: str, mode: str, reversed_: int) -> None:
    path = calibration(tmp_path, j2={"drive_mode": reversed_})
    offsets = dict(zip(JOINTS, ZEROS_DEG, strict=True))
    text, changes = with_zero_offsets(read_calibration(path), offsets, mode, maker)
    before, after = json.loads(path.read_text()), json.loads(text)
    for name, change in zip(JOINTS, changes, strict=True):
        for raw in (1200, 2000, 2900):
            gained = reading(raw, after[name], maker, mode) - reading(raw, before[name], maker, mode)
            assert gained == pytest.approx(offsets[name], abs=0.51 * TICK)
            assert gained + change.left_deg == pytest.approx(offsets[name], abs=1e-9)
        assert {key: v for key, v in after[name].items() if key != "homing_offset"} == {
            key: v for key, v in before[name].items() if key != "homing_offset"
        }


def test_an_offset_that_no_servo_holds_is_refused(tmp_path: Path) -> None:
    path = calibration(tmp_path, j1={"homing_offset": -2040})
    with pytest.raises(FileError, match=r"servo 'j1' would get a homing offset of -2057, it holds 2047 either way"):
        with_zero_offsets(read_calibration(path), {"j1": 1.5}, "DEGREES", "feetech")
    with pytest.raises(FileError, match="has no servo 'j9'"):
        with_zero_offsets(read_calibration(path), {"j9": 1.5}, "DEGREES", "feetech")


def point(q: np.ndarray) -> np.ndarray:
    """Tool point mm of the arm with its real angles, rad."""
    T = np.eye(4)
    for angle, row in zip(q, ARM["rows"], strict=True):
        c, s, a = np.cos(angle), np.sin(angle), np.radians(row["alpha_deg"])
        turn = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, row["d_mm"]], [0, 0, 0, 1]])
        link = np.array(
            [[1, 0, 0, row["a_mm"]], [0, np.cos(a), -np.sin(a), 0], [0, np.sin(a), np.cos(a), 0], [0, 0, 0, 1]]
        )
        T = T @ turn @ link
    return (T @ [10.0, 5.0, 30.0, 1.0])[:3]


def measured(
    k: Kilter, folder: Path, name: str, rows: int, noise_mm: float = 0.05, calibration: Path | None = None
) -> str:
    """A version of the arm, from points of a tracker that scatters."""
    k.add_robot({**ARM, "name": name})
    rng = np.random.default_rng(1)
    q = rng.uniform(-1.4, 1.4, (rows, 3))
    seen = np.array([point(row + np.radians(ZEROS_DEG)) for row in q]) + rng.normal(0.0, noise_mm, (rows, 3))
    data = folder / "measured.csv"
    head = "q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm"
    np.savetxt(data, np.hstack([np.degrees(q), seen]), delimiter=",", header=head, comments="", fmt="%.12g")
    campaign = k.upload(name, data, calibration=calibration, progress=False)
    return str(k.identify(name, campaign, progress=False).version_id)


def test_from_measured_poses_to_ticks(k: Kilter, command: Command, tmp_path: Path) -> None:
    version = measured(k, tmp_path, "servos", 40)
    path, copy = calibration(tmp_path), tmp_path / "trued.json"
    asked = ("homing", path, version, "-o", copy, "--servos", "feetech", "--norm-mode", "DEGREES")
    found = command.json(*asked)
    assert path.read_text() == calibration(tmp_path).read_text()
    after = {one["servo"]: one for one in found["servos"]}
    # A zero of the version is within its interval of the arm's, and of one that is shared with the base nothing is written.
    assert (after["j2"]["state"], after["j1"]["state"]) == ("known", "held")
    assert abs(after["j2"]["offset_deg"] - ZEROS_DEG[1]) < after["j2"]["half_width_deg"] < 0.2
    assert after["j2"]["half_width_ticks"] == pytest.approx(after["j2"]["half_width_deg"] / TICK)
    assert after["j1"]["before"] == after["j1"]["after"] == 30
    ticks = round(after["j2"]["offset_deg"] / TICK)
    assert json.loads(copy.read_text())["j2"]["homing_offset"] == after["j2"]["after"] == 10 - ticks
    assert any(line == '-        "homing_offset": 10,' for line in found["diff"])
    assert any(line == f'+        "homing_offset": {10 - ticks},' for line in found["diff"])
    text = command(*asked)
    assert "It is another calibration" in text
    assert "No campaign of this version states with which calibration it was measured" in text
    assert "not told: shared with base or tool" in text
    half = after["j2"]["half_width_ticks"]
    assert f"±{half:.0f} " in text if half >= 1.0 else f"±{max(half, 0.1):.1f} " in text
    assert "±0 " not in text
    assert "is the calibration itself" in command.json(*asked[:4], path, *asked[5:], code=2)["detail"]
    told = command.json("export", version, "--format", "mdh-csv", "-o", tmp_path / "table.csv")["zero_offsets"]
    assert [one["state"] for one in told] == [after[name]["state"] for name in JOINTS]


def test_a_zero_that_the_poses_do_not_tell_is_not_written(k: Kilter, command: Command, tmp_path: Path) -> None:
    """Readings that scatter by centimetres: what is off by less than its interval stays, unless it is asked for."""
    version = measured(k, tmp_path, "few", 12, 15.0)
    path, copy = calibration(tmp_path), tmp_path / "trued.json"
    asked = ("homing", path, version, "-o", copy, "--servos", "feetech", "--norm-mode", "DEGREES")
    refused = command.json(*asked, code=2)["detail"]
    assert f"Version {version} tells no zero by a tick or more" in refused
    assert "j2 not told apart from 0" in refused
    assert not copy.exists()
    after = {one["servo"]: one for one in command.json(*asked, "--uncertain")["servos"]}
    assert after["j2"]["state"] == "uncertain"
    assert abs(after["j2"]["offset_deg"]) < after["j2"]["half_width_deg"]
    assert abs(after["j2"]["offset_deg"] - ZEROS_DEG[1]) < after["j2"]["half_width_deg"]
    assert after["j2"]["after"] != after["j2"]["before"]
    assert after["j1"]["after"] == after["j1"]["before"]
