"""`kilter identify --check` and `kilter gap --check`: what a job would do, and that none is made."""

from __future__ import annotations

import json

import pytest

from kilter_client import Kilter
from kilter_client.cli import run
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
