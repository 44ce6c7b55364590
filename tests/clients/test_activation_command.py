"""`kilter activate`, `rollback` and `activations`: what was compared, what is refused, what was forced."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kilter_client import Kilter
from kilter_client.cli import run
from kilter_client.cli.reports.answer import suggest_for_version
from kilter_client.cli.reports.results import show_job, show_version

Write = Callable[..., Path]


def identified(kilter: Kilter, robot: str, file: Path) -> str:
    """Upload a file as a campaign of its own and identify with it; returns the version."""
    campaign = kilter.campaigns.add(robot, file.stem)["id"]
    kilter.campaigns.upload(campaign, file)
    job = kilter.jobs.run("identify", robot, [campaign])
    assert job["result"]["objections"] == []
    return str(job["result"]["version_id"])


def shaken(file: Path, noise_mm: float) -> Path:
    """The same rows as a worse instrument would have measured them."""
    head, rows = file.read_text().splitlines()[0], np.loadtxt(file, delimiter=",", skiprows=1)
    rows[:, -3:] += np.random.default_rng(3).normal(0.0, noise_mm, (len(rows), 3))
    np.savetxt(file, rows, delimiter=",", header=head, comments="", fmt="%.12g")
    return file


def test_a_worse_version_is_refused_forced_and_rolled_back(
    kilter: Kilter, robot: str, write_campaign: Write, capsys: pytest.CaptureFixture[str]
) -> None:
    good = identified(kilter, robot, write_campaign(60, "good.csv", 1))
    coarse = identified(kilter, robot, shaken(write_campaign(12, "coarse.csv", 2), 1.0))
    checked = kilter.campaigns.add(robot, "checked", role="confirmation")["id"]
    kilter.campaigns.upload(checked, write_campaign(30, "checked.csv", 3))
    capsys.readouterr()

    assert run(["activate", good]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"{robot} v1 is active. Mean error on 42 poses that no fit used: " in said
    assert re.search(r"Corrects all \d+ measured poses\.|Corrects all \d+ measured poses, \d+ ", said)
    assert "Compared on" not in said  # with no version active before, the headline has all of it
    assert run(["activate", coarse]) == 1
    refused = " ".join(capsys.readouterr().err.split())
    for words in (f"Version {robot} v2 was not activated", "On 30 poses", f"version {robot} v1, active now", "--force"):
        assert words in refused, words
    assert run(["activate", coarse, "--force", "--reason", "for a trial"]) == 0
    assert "forced, though: On 30 poses" in " ".join(capsys.readouterr().out.split())
    assert run(["rollback", robot]) == 0
    assert f"{robot} v1 is active again." in capsys.readouterr().out
    assert run(["activations", robot]) == 0
    log = " ".join(capsys.readouterr().out.split())
    places = [log.index(f"{what} {robot} v{number} admin") for what, number in (
        ("rollback", 1), ("forced activate", 2), ("activate", 1),
    )]  # fmt: skip
    assert places == sorted(places)
    assert "admin for a trial" in log


OBJECTION = {"code": "error_beyond_limit", "message": "It leaves 443 mm on the rows it was fitted to."}
JOB: dict[str, Any] = {"id": "job_1", "robot": "arm", "state": "succeeded"}


@pytest.mark.parametrize("kind", ["identify", "joint_parameters"])
def test_a_version_with_objections_is_not_recommended(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    version = {"id": "ver_1", "active": False, "robot": "arm", "objections": []}
    advised = suggest_for_version(version)
    assert advised == ["Next: kilter activate ver_1"]
    assert suggest_for_version(version | {"objections": [OBJECTION]}) == []
    show_job(JOB | {"kind": kind, "result": {"version_id": "ver_1", "objections": [OBJECTION]}}, suggested=advised)
    said = capsys.readouterr().out
    assert "443 mm" in said
    assert "kilter activate" not in said
    show_job(JOB | {"kind": kind, "result": {"version_id": "ver_1", "objections": []}}, suggested=advised)
    assert "kilter activate ver_1" in capsys.readouterr().out


def test_a_version_says_what_speaks_against_it(capsys: pytest.CaptureFixture[str]) -> None:
    version = {"id": "ver_1", "robot": "arm", "active": False, "job_id": "job_1", "parent_id": None, "campaigns": []}
    show_version(version | {"objections": [OBJECTION]})
    assert "not fit to correct with: It leaves 443 mm" in capsys.readouterr().out
