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


@pytest.mark.parametrize("command", ["identify", "gap"])
def test_swapped_columns_are_named_and_nothing_is_stored(
    kilter: Kilter, robot: str, write_campaign: Any, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    file = swapped(write_campaign(), "q3_deg", "q4_deg")
    assert run(["upload", robot, str(file), "--json"]) == 0
    campaign = json.loads(capsys.readouterr().out)["campaign_id"]
    assert run([command, robot, "--campaign", campaign]) == 1
    said = " ".join("".join(capsys.readouterr()).split())
    assert "Joints 3 and 4 look swapped" in said
    assert "swap the columns" in said
    assert "kilter activate" not in said
    assert kilter.versions.list(robot) == []
