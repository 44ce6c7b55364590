"""`kilter identify --check` and `kilter gap --check`: what a job would do, and that none is made."""

from __future__ import annotations

import json

import pytest

from kilter_client import Kilter
from kilter_client.cli import run
from kilter_client.cli.analyse import show_check
from tests.clients.conftest import WriteCampaign


def test_a_check_says_what_a_job_would_do_and_makes_none(
    kilter: Kilter, robot: str, write_campaign: WriteCampaign, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["upload", robot, str(write_campaign(60)), "--name", "rows"]) == 0
    capsys.readouterr()
    assert run(["identify", robot, "-c", "rows", "-v", "0.25", "--check"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    expected = (
        "would run; nothing was queued", "held out: 15 poses", "identifiable, rank", "not determined by these data",
        "it would take",
    )  # fmt: skip
    for words in expected:
        assert words in said, words
    assert run(["gap", robot, "-c", "rows", "--check", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["held_out"]["how"] == "unasked"
    assert any(one["id"] == "thermal_growth" for one in told["testability"]["not_testable"])
    assert kilter.jobs.list(robot) == []


def test_a_check_of_a_job_that_would_fail_exits_with_1(
    kilter: Kilter, robot: str, write_campaign: WriteCampaign, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["upload", robot, str(write_campaign(4)), "--name", "few"]) == 0
    assert run(["identify", robot, "-c", "few", "--check"]) == 1
    assert "would fail" in capsys.readouterr().out
    told = kilter.jobs.check("identify", robot, ["few"], options={"level": 2})
    assert [one["code"] for one in told["problems"]] == ["too_few_poses"]


def test_a_remedy_is_said_once_with_all_that_it_is_for(capsys: pytest.CaptureFixture[str]) -> None:
    lacks = [{"what": f"p{k}", "reason": f"p{k} cannot be told from q{k}.", "remedy": "Hold it."} for k in range(30)]
    sums = [
        {"parameters": [{"name": f"d_{k}", "coefficient": 1.0} for k in range(count)], "sentence": f"A sum of {count}."}
        for count in (2, 9)
    ]
    seen = {
        "parameters": 40, "identifiable": ["a"], "rank": 39, "noise_mm": 0.05, "noise_from": "assumed",
        "null_directions": [{"sums": sums}],
    }  # fmt: skip
    told = {
        "kind": "identify", "robot": "arm", "would_run": True, "problems": [], "campaigns": [], "limited": [],
        "held_out": {"how": "none"}, "identifiability": seen, "missing": lacks,
        "duration_s": {"expected": 1.0, "low": 1.0, "high": 2.0, "basis": "a rule"},
    }  # fmt: skip
    show_check(told)
    said = " ".join(capsys.readouterr().out.split())
    assert said.count("Hold it.") == 1
    assert all(f"p{k}" in said for k in range(30))
    assert "(30 in all)" in said
    assert "A sum of 2." in said
    assert "A sum of 9." not in said


def test_a_check_fits_a_screen_and_its_details_have_all(capsys: pytest.CaptureFixture[str]) -> None:
    lacks = [
        {"what": f"effect_{k}", "reason": f"No column {k}.", "remedy": f"Measure {k} " + "x" * 90} for k in range(20)
    ]
    told = {
        "kind": "gap", "robot": "arm", "would_run": True, "problems": [], "campaigns": [], "limited": [],
        "held_out": {"how": "none"}, "missing": lacks,
        "duration_s": {"expected": 1.0, "low": 1.0, "high": 2.0, "basis": "a rule"},
    }  # fmt: skip
    show_check(told, details=False)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 25
    assert any(line.startswith("  effect_5: Measure 5 ") for line in lines)
    assert "  and 14 more (--details)" in lines
    show_check(told)
    said = capsys.readouterr().out
    assert all(f"No column {k}." in said for k in range(20))
