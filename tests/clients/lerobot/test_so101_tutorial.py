"""The commands of docs/tutorial/so-101.md on rendered pictures: an arm in MuJoCo before OpenCV's board, and what is printed
against what the arm has. The command that moves a real arm is tested with LeRobot's own bus (test_lerobot_follower.py).
"""

from __future__ import annotations

import csv
import json
import re
import runpy
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from kilter_client import Kilter
from tests.clients.files.formats.test_lerobot import calibration
from tests.clients.lerobot.so101_arm import Floats, tool, tool_mm
from tests.clients.lerobot.so101_twin import ticks
from tests.clients.lerobot.test_kit import ARM, PLAY_DEG, STIFFNESS
from tests.clients.lerobot.webcam import LIMITS_DEG, camera, rotation
from tests.clients.test_cli import Command

POSES, PAYLOADS = 20, (0.0, 0.2)  # each from both sides with both
DRAWS = runpy.run_path(
    str(Path(__file__).parents[3] / "docs/tutorial/camera_twin.py")
)  # its lens, light, blur and noise


def on_gripper() -> Floats:
    """Where the board is (4, 4), mm in the frame of the tool: held across the jaw, its print to the camera."""
    T = np.eye(4)
    T[:3, :3] = rotation(0, 100.0) @ rotation(1, 8.0)
    T[:3, 3] = [-30.0, 12.0, 18.0]
    return T


def seen(tool: Floats, mount: Floats) -> Floats:
    """The board before the camera (4, 4), m."""
    T: Floats = np.linalg.inv(camera()) @ tool @ mount
    T[:3, 3] *= 1e-3
    return T


class Photographer:
    """Drives the arm to poses, from both sides with both payloads, and keeps a picture of each with its joints."""

    def __init__(self, folder: Path) -> None:
        self.board = json.loads((folder / "board.json").read_text())
        self.sheet, self.rays = DRAWS["texture"](self.board), DRAWS["rays"]()
        self.mount, self.rng, self.folder = on_gripper(), np.random.default_rng(1), folder
        self.rows: list[list[Any]] = []
        (folder / "pictures").mkdir()

    def whole(self, reading: Floats) -> bool:
        """Whether the camera would see the whole board, were the arm nominal."""
        return bool(DRAWS["in_sight"](seen(tool(reading), self.mount), self.board))

    def take(self, reading: Floats) -> bool:
        """Four pictures; none where the board is not whole in all."""
        first = np.where(self.rng.random(5) < 0.5, -1.0, 1.0)
        states = [(kg, side) for kg in PAYLOADS for side in (first, -first)]
        boards = [seen(ARM.settled(reading, side, kg), self.mount) for kg, side in states]
        if not all(DRAWS["in_sight"](T, self.board) for T in boards):
            return False
        for (kg, side), T in zip(states, boards, strict=True):
            name = f"view{len(self.rows) + 1:03}.png"
            grey = DRAWS["picture"](T, self.sheet, self.board, self.rays, self.rng)
            cv2.imwrite(str(self.folder / "pictures" / name), grey)
            self.rows.append([name, *reading.round(6), *side.astype(int), kg])
        return True

    @property
    def off_mm(self) -> float:
        """How far the tool was from the nominal one, on average."""
        states = [(np.array(row[1:6]), np.array(row[6:11]), row[11]) for row in self.rows]
        return float(np.mean([np.linalg.norm(ARM.settled(*one)[:3, 3] - tool_mm(one[0])) for one in states]))

    def joints(self) -> Path:
        path = self.folder / "joints.csv"
        names = [*(f"q{j}_deg" for j in range(1, 6)), *(f"dir{j}" for j in range(1, 6))]
        with path.open("w", newline="") as file:
            csv.writer(file).writerows([["picture", *names, "payload_kg"], *self.rows])
        return path


def number(pattern: str, lines: list[str]) -> float:
    (found,) = (match for line in lines if (match := re.search(pattern, line)))
    return float(found[1])


@pytest.mark.timeout(900)  # a minute of computing, which waits where others compute too
def test_from_a_board_to_a_corrected_grasp(kilter: Kilter, command: Command, tmp_path: Path) -> None:
    command("board", "--columns", 5, "--rows", 4, "--square-mm", 15, "-o", tmp_path / "board.pdf")
    photographer = Photographer(tmp_path)
    while len(photographer.rows) < 4 * POSES:
        reading = ticks(photographer.rng.uniform(-1.0, 1.0, 5) * LIMITS_DEG)
        if photographer.whole(reading):
            photographer.take(reading)
    servos, views = calibration(tmp_path), tmp_path / "views.csv"

    def asked() -> dict[str, Any]:
        command("see", tmp_path / "pictures", "--board", tmp_path / "board.json", "--joints", photographer.joints(),
                "--intrinsics", "brown", "-o", views)  # fmt: skip
        return command.json(
            "kit", "so101", views, "--cameras", tmp_path / "views.json", "--calibration", servos, code=(0, 4)
        )

    found = asked()
    while wanted := [one for one in found["loads"] if one["examples_deg"]]:
        for one in wanted:
            enough = len(photographer.rows) + one["wanted"]
            while len(photographer.rows) < enough:
                example = np.round(one["examples_deg"][int(photographer.rng.integers(len(one["examples_deg"])))])
                assert photographer.take(ticks(example + photographer.rng.uniform(-2.0, 2.0, 5))), example
        found = asked()
    assert found["missing"] == []
    lines = found["lines"]
    named = [line for line in lines if re.search(r"deg of backlash$", line)]
    assert [line.split(" (")[0] for line in named] == ["joint 3"]
    assert number(r"joint 3 .* has ([\d.]+) deg of backlash", lines) == pytest.approx(PLAY_DEG[2], rel=0.2)
    for j in (2, 3, 4):
        stiffness = number(rf"joint {j} .* sags by .* \(([\d.]+) N m/rad", lines)
        assert stiffness == pytest.approx(STIFFNESS[j - 1], rel=0.15)
    assert (
        0.4 * photographer.off_mm < found["before_mm"] < photographer.off_mm
    )  # camera and board make up for some of it
    assert found["after_mm"] < 0.25
    command("activate", "latest", "--robot", "so101")
    assert_corrected(command, tmp_path)


def assert_corrected(command: Command, folder: Path) -> None:
    """Ten grasps with 200 g at poses that nobody measured, by `kilter correct` and to whole ticks."""
    rng = np.random.default_rng(7)
    wanted = rng.uniform(-1.0, 1.0, (10, 5)) * [60.0, 50.0, 50.0, 60.0, 120.0]
    head = ",".join(f"q{j}_deg" for j in range(1, 6))
    np.savetxt(folder / "path.csv", wanted, delimiter=",", header=head, comments="", fmt="%.10g")
    command("correct", "so101", folder / "path.csv", "--payload-kg", 0.2, "-o", folder / "corrected.csv")
    table = list(csv.DictReader((folder / "corrected.csv").read_text().splitlines()))
    goals = ticks(np.array([[float(row[f"q{j}_deg"]) for j in range(1, 6)] for row in table]))
    sides = np.where(rng.random((10, 5)) < 0.5, -1.0, 1.0)
    off = {
        name: np.array([
            np.linalg.norm(ARM.settled(q, side, 0.2)[:3, 3] - tool_mm(row))
            for q, side, row in zip(told, sides, wanted, strict=True)
        ])
        for name, told in (("told", ticks(wanted)), ("corrected", goals))
    }  # fmt: skip
    assert off["told"].mean() > 12.0
    assert off["corrected"].mean() < 1.0
