"""What ``kilter identify`` and ``kilter version`` print of an identification, and that it is what the JSON says."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from kilter_client.cli import run
from kilter_client.cli.reports.results import show_result

Capture = pytest.CaptureFixture[str]


def printed(capsys: Capture, *arguments: object) -> str:
    capsys.readouterr()
    code = run([str(argument) for argument in arguments])
    out = capsys.readouterr()
    assert code == 0, out.out + out.err
    return out.out


def line_of(text: str, start: str) -> list[str]:
    return next(line.split() for line in text.splitlines() if line.strip().startswith(start))


def asked(capsys: Capture, robot: str, campaign: str, *options: str) -> tuple[dict[str, Any], list[str]]:
    """Result of an identification; and what is printed of its job and of its version."""
    job: dict[str, Any] = json.loads(printed(capsys, "identify", robot, "-c", campaign, *options, "--json"))
    version = job["result"]["version_id"]
    return job["result"], [
        printed(capsys, *one, "--details") for one in (("jobs", "show", job["id"]), ("version", version))
    ]


def test_influence_intervals_observability_and_groups(
    robot: str, write_campaign: Callable[..., Path], capsys: Capture
) -> None:
    campaign = json.loads(printed(capsys, "upload", robot, write_campaign(), "--json"))["campaign_id"]
    result, texts = asked(capsys, robot, campaign, "--intervals", "bootstrap")
    row = next(p for p in result["parameters"] if p["name"] == "theta_offset_2")
    assert row["lower"] < row["value"] < row["upper"]
    seen = result["observability"]
    assert result["correlated_groups"]
    for text in texts:
        assert "95 % intervals by bootstrap" in text
        nominal, value, change, lower, _, upper = line_of(text, "theta_offset_2")[1:7]
        cells = [float(cell) for cell in (nominal, value, change, lower, upper)]
        stated = [row[key] for key in ("nominal", "value", "change", "lower", "upper")]
        assert cells == pytest.approx(stated, rel=1e-6, abs=0.051 * row["sigma"])
        assert f"{seen['rank']} of {seen['parameters']} directions seen" in text
        assert f"O3 {seen['O3']:.3g}" in text
        for group in result["correlated_groups"]:
            assert f"{group['correlation']:.3g}  {', '.join(group['parameters'])}" in text
    result, texts = asked(capsys, robot, campaign, "--method", "influence")
    for text in texts:
        assert "method influence: sweeps" in text
        for most in result["influence"][:3]:
            cells = line_of(text[text.index("influence of") :], most["name"])
            assert float(cells[3]) == pytest.approx(most["mean_mm"], rel=0.01)


def test_learned_weights_stand_on_one_line(capsys: Capture) -> None:
    names = ["a_2", *(f"residual_{axis}_{k}" for k in range(1, 9) for axis in "xyz")]
    rows = [{"name": name, "value": 0.1, "sigma": 0.01, "unit": "mm", "identifiable": True} for name in names]
    learned = {"effects": ["unknown_residual"], "kept": True, "poses": 90, "held_out_without_mm": 0.3456,
               "held_out_with_mm": 0.1, "p_value": 2.1e-9}  # fmt: skip
    show_result({"parameters": [*rows, {**rows[0], "name": "b", "plausible": False}], "learned": learned})
    text = capsys.readouterr().out
    assert "residual_x_1 to residual_z_8" in text
    assert text.count("residual_") == 2
    assert "24 learned weights" in text
    assert "held out 0.3456 mm without, 0.1 mm with it, p = 2.1e-09" in text
    assert "outside its physical range" in text


def test_figures_are_files_that_name_robot_version_and_campaigns(
    robot: str, write_campaign: Callable[..., Path], capsys: Capture, tmp_path: Path
) -> None:
    campaign = json.loads(printed(capsys, "upload", robot, write_campaign(), "--json", "--name", "Tuesday"))[
        "campaign_id"
    ]
    folder = tmp_path / "figures"
    asked_for = ("identify", robot, "-c", campaign, "-v", "0.25", "--level", "1", "--figures", folder)
    job = json.loads(printed(capsys, *asked_for, "--json"))
    drawn = {file.stem for file in folder.glob("*.json")}
    assert drawn == set(job["result"]["figures"]) >= {"held_out_errors", "residual_arrows_3d", "predicted_error"}
    for name in drawn:
        meta = json.loads((folder / f"{name}.json").read_text())["layout"]["meta"]
        assert meta == {"robot": robot, "campaigns": ["Tuesday"], "version": job["result"]["version_id"]}
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert '"figures"' not in printed(capsys, "version", job["result"]["version_id"], "--json")
    assert run([*map(str, asked_for), "--no-wait"]) == 2
