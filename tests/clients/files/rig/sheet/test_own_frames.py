"""Sheets that are laid anew, through the command: each has its own base, in training and in validation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_client import Kilter
from kilter_client.cli import run
from tests.core.campaigns import table_errors
from tests.core.drawing import Drawing, drawn
from tests.core.truth import small_pose, ur10

Floats = NDArray[np.float64]

START = np.array([0.2, -1.2, 1.6, -1.9, -1.2, 0.3])
NOISE_MM = 0.01


class Desk:
    """A UR10 with joint offsets that draws sheets; each lies a millimetre and some tenths of a degree elsewhere."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.rng = folder, np.random.default_rng(8)
        self.arm = ur10()
        offsets = {s.name: 0.01 * self.rng.normal() for s in self.arm.steps if s.name and s.joint is not None}
        self.actual = self.arm.moved(table_errors(self.arm, self.rng, 1e-5, 2e-5) | offsets)

    def drawing(self, radius: float, x: float) -> Drawing:
        return drawn(self.arm, self.actual, START, np.array([x, -0.3, 0.3]), radius, 48)

    def sheet(self, name: str, drawing: Drawing, session: int | None = None) -> Path:
        laid = small_pose(self.rng, 1e-3, 4e-3)
        points = 1e3 * ((drawing.measured() - drawing.centre) @ laid.rotation.T + drawing.centre + laid.translation)
        points += self.rng.normal(0.0, NOISE_MM, points.shape)
        head = [f"q{k + 1}_deg" for k in range(6)] + ["x_mm", "y_mm", "z_mm"] + (["session"] if session else [])
        table = np.hstack([np.degrees(drawing.q), points] + ([np.full((len(points), 1), session)] if session else []))
        path = self.folder / name
        np.savetxt(path, table, delimiter=",", header=",".join(head), comments="", fmt="%.9g")
        return path


@pytest.fixture
def desk(server: Path, tmp_path: Path) -> Desk:
    desk = Desk(tmp_path)
    with Kilter() as kilter:
        if "desk" not in [robot["name"] for robot in kilter.robots.list()]:
            kilter.robots.add(desk.arm.document() | {"name": "desk"})
    return desk


def command(capsys: pytest.CaptureFixture[str], *words: object) -> Any:
    assert run([*map(str, words), "--json"]) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


def upload(capsys: pytest.CaptureFixture[str], path: Path, device: str = "pencil") -> str:
    return str(
        command(capsys, "upload", "desk", path, "--device", device, "--name", f"{path.name} {device}")["campaign_id"]
    )


def errors(result: Any) -> float:
    return float(result["metrics"]["validation"]["identified"]["mean_mm"])


def test_a_second_sheet_is_refitted_by_itself(desk: Desk, capsys: pytest.CaptureFixture[str]) -> None:
    first, second, third = (desk.drawing(0.06, x) for x in (0.5, 0.6, 0.55))
    train = [upload(capsys, desk.sheet("a.csv", first)), upload(capsys, desk.sheet("b.csv", second))]
    held = upload(capsys, desk.sheet("c.csv", third))
    ask = ["identify", "desk", "--level", 1]
    one = command(capsys, *ask, "--campaign", train[0], "--validation", held)["result"]
    both = command(capsys, *ask, "--campaign", ",".join(train), "--validation", held)["result"]
    shared = command(capsys, *ask, "--campaign", train[0], "--validation", held, "--refit", "none")["result"]
    print(errors(one), errors(both), errors(shared))
    assert errors(one) < 4 * NOISE_MM
    assert errors(both) < 3 * NOISE_MM
    assert errors(shared) > 0.5
    assert [(row["campaign"], row["use"]) for row in both["base_refitted"]] == [
        (train[1], "train"),
        (held, "validation"),
    ]
    said = next(warning for warning in both["warnings"] if warning["code"] == "base_refitted")
    assert set(said["campaigns"]) == {train[1], held}
    assert all(name in said["message"] for name in said["campaigns"])
    assert shared["base_refitted"] == []
    assert "base_refitted" not in [warning["code"] for warning in shared["warnings"]]


def test_sessions_of_one_campaign_are_sheets_of_their_own(desk: Desk, capsys: pytest.CaptureFixture[str]) -> None:
    parts = [desk.sheet(f"s{k}.csv", desk.drawing(0.06, x), k) for k, x in ((3, 0.5), (7, 0.6))]
    lines = [path.read_text().splitlines() for path in parts]
    (desk.folder / "both.csv").write_text("\n".join([*lines[0], *lines[1][1:]]) + "\n")
    train = upload(capsys, desk.folder / "both.csv")
    held = upload(capsys, desk.sheet("d.csv", desk.drawing(0.06, 0.55)))
    found = command(capsys, "identify", "desk", "--level", 1, "--campaign", train, "--validation", held)["result"]
    assert errors(found) < 3 * NOISE_MM
    assert [(row["campaign"], row["session"]) for row in found["base_refitted"]] == [(train, 7), (held, None)]


def test_a_tracker_keeps_its_frame_unless_asked(desk: Desk, capsys: pytest.CaptureFixture[str]) -> None:
    train = upload(capsys, desk.sheet("e.csv", desk.drawing(0.06, 0.5)), "lasertracker")
    held = upload(capsys, desk.sheet("f.csv", desk.drawing(0.06, 0.6)), "lasertracker")
    ask = ["identify", "desk", "--level", 1, "--campaign", train, "--validation", held]
    kept = command(capsys, *ask)["result"]
    assert kept["base_refitted"] == []
    assert errors(kept) > 0.5
    asked = command(capsys, *ask, "--refit", "base")["result"]
    assert [row["campaign"] for row in asked["base_refitted"]] == [held]
    assert errors(asked) < 4 * NOISE_MM
