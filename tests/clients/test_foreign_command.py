"""Mixed-up measurements at the command line: refused with a sentence, nothing stored."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from kilter_client import Kilter
from kilter_client.cli import run


def swapped(source: Path, first: str, second: str) -> Path:
    """The file with the names of two columns exchanged."""
    rows = list(csv.reader(source.read_text(encoding="utf-8").splitlines()))
    names = rows[0]
    i, j = names.index(first), names.index(second)
    names[i], names[j] = names[j], names[i]
    path = source.with_name("swapped.csv")
    with path.open("w", encoding="utf-8", newline="") as out:
        csv.writer(out).writerows(rows)
    return path


def in_pieces(kilter: Kilter, robot: str, file: Path) -> str:
    """The file as a campaign of uploads too short to be judged, as an instrument sends row by row; its id."""
    campaign = str(kilter.campaigns.add(robot, "in pieces")["id"])
    head, *rows = file.read_text(encoding="utf-8").splitlines()
    for first in range(0, len(rows), 10):
        piece = file.with_name(f"piece{first}.csv")
        piece.write_text("\n".join([head, *rows[first : first + 10]]) + "\n", encoding="utf-8")
        kilter.campaigns.upload(campaign, piece)
    return campaign


@pytest.mark.parametrize("command", ["identify", "gap"])
def test_swapped_columns_are_named_and_nothing_is_stored(
    kilter: Kilter, robot: str, write_campaign: Any, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    file = swapped(write_campaign(), "q3_deg", "q4_deg")
    assert run(["upload", robot, str(file)]) == 1
    at_upload = " ".join("".join(capsys.readouterr()).split())
    assert kilter.campaigns.list(robot) == []
    assert run([command, robot, "--campaign", in_pieces(kilter, robot, file)]) == 1
    by_job = " ".join("".join(capsys.readouterr()).split())
    for said in (at_upload, by_job):
        assert "Joints 3 and 4 look swapped" in said
        assert "swap the columns" in said
        assert "kilter activate" not in said
    assert kilter.versions.list(robot) == []


def test_a_version_that_predicts_worse_is_not_offered(
    kilter: Kilter, robot: str, write_campaign: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    ids = []
    for name, poses, seed in (("few.csv", 15, 3), ("held.csv", 40, 4)):
        assert run(["upload", robot, str(write_campaign(poses, name, seed)), "--json"]) == 0
        ids.append(json.loads(capsys.readouterr().out)["campaign_id"])
    effects = "second_harmonic,eccentricity,encoder_scale"
    asked = [
        "identify",
        robot,
        "-c",
        ids[0],
        "-v",
        ids[1],
        "--level",
        "3",
        "--effects",
        effects,
        "--fix",
        "a_*,d_*,alpha_*",
    ]
    assert run(asked) == 0
    said = " ".join("".join(capsys.readouterr()).split())
    assert "not fit to correct with: Held-out poses are predicted worse" in said
    assert "kilter activate" not in said
    (version,) = kilter.versions.list(robot)
    assert "worse_than_geometry" in {w["code"] for w in kilter.versions.get(version["id"])["warnings"]}
