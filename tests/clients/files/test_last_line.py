"""A last line that breaks off is left out and named; a short line anywhere else is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kilter_client.cli import run
from kilter_client.errors import FileError
from kilter_files.rig.drawn_circle import read_heights

TEXTS = {
    "markers": ("Frame,A x,A y,A z\n", "{k},{k}.5,2,3\n"),
    "tools": ("Tool,Frame,Time (s),Tx,Ty,Tz,Q0,Qx,Qy,Qz\n", "1,{k},0.0{k},1,2,3,1,0,0,0\n"),
    "inclinometer": ("t_s,tilt_x_deg\n", "{k},0.{k}\n"),
    "ballbar": ("angle_deg,radius_mm\n", "{k}5,100.0{k}\n"),
    "points": ("Name,X [mm],Y [mm],Z [mm]\n", "P{k},1{k},2,3\n"),
}


def inspected(path: Path, capsys: pytest.CaptureFixture[str], code: int = 0) -> dict[str, Any]:
    assert run(["inspect", str(path), "--rate", "100", "--json"]) == code
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.parametrize("kind", TEXTS)
def test_half_a_line_at_the_end(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    head, row = TEXTS[kind]
    lines = [row.format(k=k) for k in range(10, 34)]
    path = tmp_path / "a.csv"
    path.write_text(head + "".join(lines))
    whole = inspected(path, capsys)
    cut = lines[-1].rpartition(",")[0]
    path.write_text(head + "".join(lines[:-1]) + cut)
    found = inspected(path, capsys)
    size = "frames" if "frames" in whole else "rows"
    assert found[size] == whole[size] - 1
    assert any("line 25, the last, is cut off" in text for text in found["warnings"]), found["warnings"]
    path.write_text(head + "".join([*lines[:10], cut + "\n", *lines[10:]]))
    refused = inspected(path, capsys, 1)
    assert "line 12" in refused["detail"]


def test_heights_say_so_too(tmp_path: Path) -> None:
    path = tmp_path / "h.csv"
    path.write_text("t_s,h_mm\n0,1\n1,2\n2,3\n3")
    found = read_heights(path)
    assert found.mm.tolist() == [1, 2, 3]
    assert "line 5, the last, is cut off (1 of 2 cells)" in found.note
    path.write_text("t_s,h_mm\n0,1\n1\n2,3\n3,4\n")
    with pytest.raises(FileError, match="line 3"):
        read_heights(path)


@pytest.mark.parametrize("rate", [30, 60, 500])
@pytest.mark.parametrize("motion", ["still", "stops", "wander"])
@pytest.mark.parametrize("sigma", [(0.05, 0.05, 0.05), (0.02, 0.03, 0.08)])
def test_noise_is_that_of_a_coordinate(
    rate: int, motion: str, sigma: tuple[float, float, float], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from tests.clients.files.simulated import arm, stops, wander, write_csv

    rng, t = np.random.default_rng(rate), np.arange(0.0, 40.0, 1 / rate)
    poses = rng.uniform(-60, 60, (8, 3))
    q = {"still": 0 * t[:, None] + poses[0], "stops": stops(poses, 3.0, 2.0, t), "wander": wander(t)}[motion]
    points = arm(q) + rng.normal(0.0, sigma, (len(t), 3, 3))
    found = inspected(write_csv(tmp_path / "a.csv", points, float(rate)), capsys)
    wanted = float(np.sqrt(np.mean(np.square(sigma))))
    assert [marker["noise_mm"] for marker in found["markers"]] == pytest.approx([wanted] * 3, rel=0.08)


def test_noise_of_rounded_coordinates_is_not_a_step(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from tests.clients.files.simulated import write_csv

    rng = np.random.default_rng(1)
    points = np.round(rng.normal([100.0, 200.0, 300.0], 0.05, (4000, 3, 3)), 1)
    found = inspected(write_csv(tmp_path / "a.csv", points, 100.0), capsys)
    # The noise of the rounding, a step over the root of twelve, is in what was recorded.
    wanted = float(np.hypot(0.05, 0.1 / np.sqrt(12)))
    assert [marker["noise_mm"] for marker in found["markers"]] == pytest.approx([wanted] * 3, rel=0.05)
