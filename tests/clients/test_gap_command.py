"""`kilter gap` and `kilter plan` against a real server: what is printed, and the files that are written."""

from __future__ import annotations

import csv
import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest

from kilter_client import FileError, Kilter
from kilter_client.cli import run
from kilter_client.results import plots
from tests.blind.generator import Case, Hidden, Options, generate

EFFECTS = "backlash,friction_windup,eccentricity,encoder_scale,thermal_growth"
QUICK = ("--effects", EFFECTS, "--option", "resamples=20", "--option", "bootstraps=499")


@pytest.fixture(scope="module")
def arm() -> Any:
    """A simulated Katana with play in joint 1, without any code of Kilter's."""
    case = Case("cli", "katana", (Hidden("backlash", (0,)),), (900.0,), 45, Options(temperature="constant"), "named", 5)
    return generate(case)


def campaign(kilter: Kilter, arm: Any, name: str, folder: Path) -> str:
    """Add the arm and its rows; returns the campaign's id."""
    kilter.robots.add({**arm.document, "name": name})
    file = folder / "rows.csv"
    with file.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(arm.columns)
        writer.writerows(zip(*(values.tolist() for values in arm.columns.values()), strict=True))
    assert run(["upload", name, str(file)]) == 0
    return str(kilter.campaigns.list(name)[0]["id"])


def test_the_whole_loop_in_one_command(
    kilter: Kilter, arm: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = campaign(kilter, arm, "gap-cli", tmp_path)
    figures, poses = tmp_path / "figures", tmp_path / "next.csv"
    capsys.readouterr()
    arguments = ["gap", "gap-cli", "-c", rows, "-v", "0.25", *QUICK, "--figures", str(figures), "--poses", str(poses)]
    assert run([*arguments, "--details"]) == 0
    printed = capsys.readouterr()
    said = " ".join(printed.out.split())
    for words in (
        "verdict: closed", "Where the model is wrong", "excess chi2", "What is missing", "backlash",
        "friction_windup", "amplitude", "interval", "The gap", "held out", "noise floor", "noise of a coordinate:",
        "corrections work in the base frame of the registration", "closed on held-out rows",
        "negative control passed", "What these data cannot test", "how to test it", "kilter activate gap-cli v1",
    ):  # fmt: skip
        assert words in said, words
    drawn = {file.stem for file in figures.glob("*.json")}
    assert {"gap_bar", "residual_joint_1", "contribution", "alias_matrix"} <= drawn
    for name in drawn:
        assert set(json.loads((figures / f"{name}.json").read_text())) == {"data", "layout"}
        assert (figures / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert ElementTree.parse(figures / f"{name}.svg").getroot().tag.endswith("svg")

    version = kilter.versions.list("gap-cli")[0]["id"]
    assert run(["gap", "gap-cli", "-c", rows, *QUICK, "--start", version, "--json"]) == 0
    printed = capsys.readouterr()
    again = json.loads(printed.out)
    assert printed.err == ""
    assert again["result"]["verdict"] == "no_gap"
    assert again["options"]["start"] == version
    assert run(["jobs", "show", again["id"], "--details"]) == 0
    assert "Nothing is missing that the library could name" in capsys.readouterr().out


def test_plans_are_files_a_robot_can_run(
    kilter: Kilter, robot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "poses.csv"
    plan = ["plan", robot, "-o", str(file)]
    assert run([*plan, "--purpose", "iso9283", "--count", "10"]) == 0
    assert "10 poses for iso9283" in capsys.readouterr().out
    head, *rows = csv.reader(file.read_text().splitlines())
    assert (head, len(rows)) == ([f"q{j}_deg" for j in range(1, 6)], 10)
    effects = '{"id": "eccentricity", "joints": [2]}'
    apart = [*plan, "--purpose", "separate", "--effects", effects, "--effects", "backlash", "--count", "4"]
    assert run(apart) == 0
    said = capsys.readouterr().out
    assert "eccentricity j2 and backlash" in said
    assert "Collisions are not checked" in said
    assert "information times" in said
    head, *rows = csv.reader(file.read_text().splitlines())
    assert {"q1_deg", "dir1"} <= set(head)  # a backlash feels the side that a pose is reached from, and no load
    # Poses of the file can be filled with measurements and uploaded: nothing in it is refused.
    measured = tmp_path / "measured.csv"
    lines = [
        ",".join([*head, "x_mm", "y_mm", "z_mm"]),
        *(",".join([*row, "300", str(k), "200"]) for k, row in enumerate(rows)),
    ]
    measured.write_text("\n".join(lines) + "\n")
    assert run(["upload", robot, str(measured), "--dry-run"]) == 0
    assert run([*plan, "--purpose", "iso9283", "--no-wait"]) == 2
    assert run([*plan, "--purpose", "paint"]) == 1


def test_without_matplotlib_the_figures_are_json(tmp_path: Path) -> None:
    layout = {"title": {"text": "t"}, "xaxis": {"title": {"text": ""}}, "yaxis": {"title": {"text": "mm"}}}
    figure = {"data": [{"type": "bar", "x": ["a"], "y": [1.0]}], "layout": layout}
    written = plots.save_figures({"bar": figure}, tmp_path, ())
    assert [file.name for file in written] == ["bar.json"]
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError):
        plots.save_figures({"bar": figure}, tmp_path / "file", ())
    first, second = (plots.draw(figure, tmp_path / name, ("svg",))[0].read_bytes() for name in "ab")
    assert first == second
