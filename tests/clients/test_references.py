"""Names, prefixes and `latest` in the command and the library, against a real server."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from kilter_client import Kilter
from kilter_client.cli import run
from kilter_client.cli.terminal.arguments import validation
from kilter_client.errors import ConflictError, NotFoundError, UsageError

Write = Callable[..., Path]
Capture = pytest.CaptureFixture[str]


class Command:
    """Runs ``kilter`` in this process and keeps stdout and stderr apart."""

    def __init__(self, capsys: Capture) -> None:
        self._capsys = capsys

    def __call__(self, *arguments: object, code: int = 0) -> tuple[str, str]:
        self._capsys.readouterr()
        found = run([str(argument) for argument in arguments])
        printed = self._capsys.readouterr()
        assert found == code, printed.out + printed.err
        return printed.out, printed.err

    def json(self, *arguments: object, code: int = 0) -> dict[str, Any]:
        out, err = self(*arguments, "--json", code=code)
        assert err == ""
        document: dict[str, Any] = json.loads(out)
        return document


@pytest.fixture
def command(capsys: Capture) -> Command:
    return Command(capsys)


def test_a_calibration_without_copying_an_id(
    robot: str, kilter: Kilter, command: Command, write_campaign: Write, tmp_path: Path
) -> None:
    train, held_out = write_campaign(60, "train.csv"), write_campaign(20, "held-out.csv", 2)
    first = command.json("upload", robot, train, "--name", "monday morning, Größe")["campaign_id"]
    assert command.json("upload", robot, train, "--name", "monday morning, Größe")["campaign_id"] == first
    second = command.json("upload", robot, held_out)["campaign_id"]
    command("campaigns", "name", first, "monday morning")
    out, err = command("identify", robot, "-c", "monday morning", "-v", "latest", "--level", "1", "--name", "monday")
    assert err == "campaign 'latest' is held-out.csv\njob: monday\n"  # a name says by itself what it stands for
    version = kilter.versions.list(robot)[0]
    assert version["name"] == "monday"
    numbered = f"{robot} v1"
    assert f"Stored as {numbered}" in out
    assert version["id"] not in out  # people read numbers, programs ids
    job = version["job_id"]
    assert command.json("jobs", "show", "latest", "--robot", robot)["id"] == job
    assert command.json("jobs", "show", job[:14], "--robot", robot)["name"] == "monday"
    out, err = command("activate", "latest", "--robot", robot)
    assert f"version 'latest' is {numbered} ('monday')" in err
    assert f"{numbered} is active" in out
    for named in ((robot, "v1"), (numbered,), ("v1", "--robot", robot)):  # as a person types it, in quotes or not
        assert command.json("activate", *named)["id"] == version["id"]
    out, err = command("version", version["id"][:14])
    assert f"version {version['id'][:14]!r} is {numbered} ('monday')\n" in err
    assert command.json("export", "monday", "--robot", robot, "-o", tmp_path / "v.json")["version_id"] == version["id"]
    assert command.json("diff", "latest", "monday", "--robot", robot)["a"] == version["id"]
    assert command.json("diff", robot, "v1", "nominal")["a"] == version["id"]
    out, err = command("evaluate", robot, "-c", second[4:14], "--version", "monday")
    assert f"campaign {second[4:14]!r} is held-out.csv" in err
    assert "monday" in command("versions", robot)[0]
    assert "monday" in command("jobs", "list", "--robot", robot)[0]


def test_the_library_takes_references(robot: str, kilter: Kilter, write_campaign: Write) -> None:
    campaign = kilter.campaigns.add(robot, "a")["id"]
    kilter.campaigns.upload("a", write_campaign(), robot=robot)
    kilter.campaigns.upload("latest", write_campaign(20, "more.csv", 3), robot=robot)
    assert kilter.campaigns.get(campaign[:12], robot)["rows"] == 60
    job = kilter.jobs.run("identify", robot, ["a"], options={"level": 1}, name="first")
    assert job["campaigns"] == [campaign]
    again = kilter.jobs.run("identify", robot, ["latest"], options={"level": 1, "start": "first"})
    assert again["options"]["start"] == job["result"]["version_id"]
    assert kilter.versions.activate("first", robot=robot)["id"] == job["result"]["version_id"]
    assert kilter.jobs.wait("first", robot=robot)["id"] == job["id"]
    found = kilter.resolve("version", "latest", robot)
    assert (found.id, found.by, found.robot) == (again["result"]["version_id"], "latest", robot)
    with pytest.raises(NotFoundError, match="has no campaign 'b'"):
        kilter.jobs.submit("identify", robot, ["b"])
    changed = kilter.versions.change("latest", name="second", notes="warm", robot=robot)
    assert (changed["name"], changed["notes"]) == ("second", "warm")
    with pytest.raises(ConflictError, match="has a version called 'first' already"):
        kilter.versions.change("latest", name="first", robot=robot)


def test_a_file_of_the_same_name_is_numbered_and_its_bytes_are_known_again(
    robot: str, command: Command, write_campaign: Write
) -> None:
    first = command.json("upload", robot, write_campaign(20, seed=1))["campaign_id"]
    second = command.json("upload", robot, write_campaign(20, seed=2))["campaign_id"]
    assert first != second
    assert command.json("upload", robot, write_campaign(20, seed=2))["campaign_id"] == second
    assert [c["name"] for c in command.json("campaigns", robot)["campaigns"]] == ["measured.csv", "measured.csv (2)"]


def test_bad_references_are_one_sentence_with_the_choices(robot: str, command: Command, kilter: Kilter) -> None:
    made = {name: kilter.campaigns.add(robot, name)["id"] for name in ("monday", "tues day")}
    _, err = command("identify", robot, "-c", "cmp_", code=1)
    assert err.startswith(f"Error: --campaign: Robot {robot!r} has no campaign 'cmp_'. There are: 'tues day', monday.")
    problem = command.json("campaigns", "name", "monday", "tues day", "--robot", robot, code=1)
    assert problem["code"] == "name_taken"
    assert "another name" in problem["detail"]
    problem = command.json("campaigns", "name", "monday", "cmp_1", "--robot", robot, code=1)
    assert problem["code"] == "name_invalid"
    other = f"{robot[:50]}-other"
    kilter.robots.add({"name": other, "convention": "preset", "preset": "katana450-chapter4"})
    twin = kilter.campaigns.add(other, "monday")["id"]
    problem = command.json("campaigns", "retire", "monday", code=1)
    assert problem["code"] == "reference_ambiguous"
    assert all(one in problem["detail"] for one in (made["monday"], twin, "--robot"))
    _, err = command("campaigns", "retire", "monday", code=1)
    assert all(one in err for one in (made["monday"], twin, "--robot"))  # their name is one


def test_retire_restore_and_purge(robot: str, command: Command, kilter: Kilter) -> None:
    campaign = kilter.campaigns.add(robot, "monday")["id"]
    assert "campaign monday is retired" in command("campaigns", "retire", "monday", "--robot", robot)[0]
    assert command.json("campaigns", robot)["campaigns"] == []
    assert "monday (retired)" in command("campaigns", robot, "--retired")[0]
    assert "in use again" in command("campaigns", "restore", "monday", "--robot", robot)[0]
    assert command("campaigns", "note", "monday", "warm", "--robot", robot)[0] == "campaign monday: warm\n"
    _, err = command("campaigns", "purge", campaign[:14], "--yes", code=2)
    assert f"takes the full id: {campaign[:14]!r} is {campaign}" in err
    _, err = command("campaigns", "purge", campaign, code=2)
    assert f"`kilter measure campaigns purge {campaign} --yes`" in err
    assert "is purged" in command("campaigns", "purge", campaign, "--yes")[0]
    assert kilter.tombstones(robot)[0]["id"] == campaign
    assert "purged by admin" in command("campaigns", "retire", campaign, code=1)[1]
    command("robot", "note", robot, "the left one")
    assert "the left one" in command("robot", "show", robot)[0]
    command("robot", "retire", robot)
    assert robot not in command("robot", "list")[0]
    retired = {one["name"]: one["retired_at"] for one in command.json("robot", "list", "--retired")["robots"]}
    assert retired[robot]
    with pytest.raises(ConflictError, match=f"kilter robot restore {re.escape(robot)}"):
        kilter.campaigns.add(robot, "late")
    command("robot", "restore", robot)
    assert "--yes" in command("robot", "purge", robot, code=2)[1]
    command("robot", "purge", robot, "--yes")


def test_groups_list_when_no_command_is_given(robot: str, command: Command) -> None:
    assert command.json("versions", robot) == command.json("versions", "list", robot) == {"versions": []}
    assert command("campaigns", "--help")[0].count("purge") >= 1
    assert "ROBOT" in command("versions", "list", code=2)[1]


@pytest.mark.parametrize(
    ("text", "meant"),
    [("0.3", 0.3), ("0", 0.0), ("64", ["64"]), ("1e5", ["1e5"]), ("latest", ["latest"]), ("folds:3", {"folds": 3})],
)
def test_a_number_that_may_begin_an_id_is_no_fraction(text: str, meant: object) -> None:
    assert validation([text]) == meant


def test_other_numbers_are_fractions_that_cannot_be() -> None:
    for text in ("1.5", "-1", "1.0"):
        with pytest.raises(UsageError, match="between 0 and 1"):
            validation([text])
