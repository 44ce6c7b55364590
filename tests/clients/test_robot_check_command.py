"""``kilter robot check``: the drawing, the picture and the list, on real robots and a real server."""

from __future__ import annotations

import json
import math
import struct
from pathlib import Path

import pytest
import typer

from kilter_client import Kilter
from kilter_client.cli import run
from kilter_client.cli.robot.robots import drawing

Capture = pytest.CaptureFixture[str]

TABLE = "theta_offset_deg,d_mm,a_mm,alpha_deg\n0,300,0,90\n0,0,500,0\n0,0,400,0\n"


def test_a_table_is_drawn_and_listed(server: Path, tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "arm.csv"
    path.write_text(TABLE)
    assert run(["robot", "check", str(path), "--convention", "dh", "--details"]) == 0
    text = capsys.readouterr().out
    side = text.split("z up\n")[1].split("\n\n")[0].splitlines()
    # Upright for 300 mm, then level for 900: base below, tool at the far right of the top line.
    assert side[-1].startswith("o")
    assert side[0].endswith("T")
    assert side[0].startswith("2")
    assert len(side[0]) == 60
    assert "reach of the tool from the first axis: 9" in text
    assert "suspicious: No limits for j1, j2, j3" in text
    assert "90 deg, 0.0 mm" in text
    with Kilter() as kilter:
        assert "arm" not in [robot["name"] for robot in kilter.robots.list()]


def test_the_picture_is_a_png_with_the_arm_in_it(server: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "arm.png"
    assert run(["robot", "check", "--preset", "ur10", "--plot", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["reach_mm"] > 1200
    data = out.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", data[16:24])
    assert (width, height) > (1000, 400)
    assert run(["robot", "check", "--preset", "ur10", "--plot", str(tmp_path / "arm.svg")]) == 0
    assert "ur10 at zero" in (tmp_path / "arm.svg").read_text()
    assert run(["robot", "check", "--preset", "ur10", "--plot", "arm.pdf"]) == 2


def test_drawings_keep_the_proportions() -> None:
    circle = [(math.cos(t) * 100, math.sin(t) * 100) for t in (k * 0.3 for k in range(22))]
    rows = drawing(circle).splitlines()
    assert max(len(row) for row in rows) == pytest.approx(2 * len(rows), abs=2)
    assert drawing([(0, 0), (0, 0), (0, 0)]) == "o"


def test_a_table_is_written_in_another_convention(server: Path, tmp_path: Path, capsys: Capture) -> None:
    path, out = tmp_path / "arm.csv", tmp_path / "arm.json"
    path.write_text(TABLE)
    assert run(["robot", "convert", str(path), "--convention", "dh", "--to", "mcpc", "-o", str(out)]) == 0
    document = json.loads(out.read_text())
    assert (document["name"], document["convention"], len(document["rows"])) == ("arm", "mcpc", 3)
    urdf = tmp_path / "arm.urdf"
    assert run(["robot", "convert", str(out), "--to", "urdf", "-o", str(urdf)]) == 0
    assert urdf.read_text().startswith("<?xml")
    capsys.readouterr()
    described = ["--name", "arm", "--base-link", "base_link", "--tip-link", "flange"]
    assert run(["robot", "check", str(urdf), *described, "--json"]) == 0
    # Upright for 300 mm, then level for 900.
    tool = json.loads(capsys.readouterr().out)["zero"]["tool"]
    assert (tool["x_mm"], tool["y_mm"], tool["z_mm"]) == pytest.approx((900, 0, 300))
    assert run(["robot", "convert", str(out), "--to", "euler"]) == 1


def test_a_robot_from_circles_and_a_frame_from_points(server: Path, tmp_path: Path, capsys: Capture) -> None:
    # Two joints about parallel axes 500 mm apart, the point 300 mm from the second; the device sees the base at (100, 0, 50).
    path, out = tmp_path / "circles.csv", tmp_path / "arm.json"
    lines = ["q1_deg,q2_deg,x_mm,y_mm,z_mm"]
    for one, two in [(a, 30.0) for a in range(0, 100, 10)] + [(20.0, a) for a in range(-60, 60, 10)]:
        a, b = math.radians(one), math.radians(one + two)
        x, y = 100 + 500 * math.cos(a) + 300 * math.cos(b), 500 * math.sin(a) + 300 * math.sin(b)
        lines.append(f"{one},{two},{x:.9f},{y:.9f},50")
    path.write_text("\n".join(lines) + "\n")
    assert run(["robot", "from-circles", str(path), "--name", "scara", "--convention", "poe", "-o", str(out)]) == 0
    assert "revolute" in capsys.readouterr().out
    document = json.loads(out.read_text())
    assert document["name"] == "scara"
    assert (document["base"]["x_mm"], document["base"]["y_mm"]) == pytest.approx((100, 0), abs=1e-6)
    assert math.dist(document["axes"][1]["point_mm"][:2], (0, 0)) == pytest.approx(500, abs=1e-6)
    assert run(["robot", "add", str(out)]) == 0
    capsys.readouterr()
    points = tmp_path / "points.csv"
    points.write_text(
        "feature,x_mm,y_mm,z_mm\nplane,0,0,5\nplane,9,0,5\nplane,0,9,5\nline,0,1,5\nline,7,1,5\norigin,2,3,9\n"
    )
    assert run(["robot", "frame", str(points), "--into", str(out), "--json"]) == 0
    pose = json.loads(capsys.readouterr().out)["pose"]
    assert (pose["x_mm"], pose["y_mm"], pose["z_mm"]) == pytest.approx((2, 3, 5))
    assert json.loads(out.read_text())["base"] == pose
    points.write_text("feature,x_mm,y_mm,z_mm\ncorner,0,0,5\n")
    assert run(["robot", "frame", str(points)]) == 1
    assert "line 2: feature is 'corner'" in capsys.readouterr().err
    points.write_text(
        "name,known_x_mm,known_y_mm,known_z_mm,x_mm,y_mm,z_mm\nA,0,0,0,1,2,3\nB,9,0,0,10,2,3\nC,0,9,0,1,11,3\n"
    )
    assert run(["robot", "frame", str(points)]) == 0
    assert '"x_mm": 1.0' in capsys.readouterr().out


def test_every_command_that_reads_a_robot_takes_the_same_options() -> None:
    from kilter_client.cli import app

    group = typer.main.get_command(app).commands["robot"]  # type: ignore[attr-defined]
    shared = {"file", "preset", "name", "base_link", "tip_link", "convention", "model", "turned", "follows"}
    own = {name: {parameter.name for parameter in group.commands[name].params} for name in ("add", "check", "convert")}
    assert all(shared <= found for found in own.values()), own
