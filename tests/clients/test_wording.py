"""Refusals of a real server as the command says them: in its own options, arguments and commands."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from kilter_client import Kilter
from kilter_client.cli import run
from kilter_client.cli.terminal.references import ROUTES, in_words, parameters_by_request_name

Write = Callable[..., Path]
Capture = pytest.CaptureFixture[str]
SERVICE = Path(__file__).resolve().parents[2] / "service"
OF_A_REQUEST = re.compile(
    r"/v1/|\b(?:options|body|query|path)\.|of kind|`(?:campaigns|validation|confirmation|options)`"
)


def refused(capsys: Capture, *arguments: object, code: int = 1) -> str:
    """Run a command that must fail, with and without --json, and return its one sentence."""
    given = [str(argument) for argument in arguments]
    capsys.readouterr()
    assert run(given) == code
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith("Error: ")
    # Names, but where a command needs an id.
    assert code == 2 or not re.search(r"\b(?:ver|cmp)_[1-9a-f][0-9a-f]{15}\b", said)
    assert run([*given, "--json"]) == code
    problem = json.loads(capsys.readouterr().out)
    ids = re.compile(r"(?:, )?(?:ver|cmp)_[0-9a-f]{16}(?: '[^']+')?")
    assert all(part in said for part in ids.split(problem["detail"]))  # the same, with ids
    assert not OF_A_REQUEST.search(problem["detail"]), problem["detail"]
    return said.removeprefix("Error: ")


def test_every_route_that_a_refusal_names_has_its_command() -> None:
    """What stands in the service's sentences, found in its sources."""
    named = set()
    for path in SERVICE.rglob("*.py"):
        # Two tables, and answers over zenoh.
        if "contract" in path.parts or path.name in ("audit.py", "policy.py", "queries.py"):
            continue
        for line in path.read_text(encoding="utf-8").splitlines():
            named |= set(
                re.findall(
                    r"\b(?:GET|POST|PATCH|DELETE) /v1/[\w/{}-]*[\w}]", line.replace("{{", "{").replace("}}", "}")
                )
            )
    assert named == set(ROUTES)


@pytest.mark.parametrize(
    ("arguments", "said", "typed"),
    [
        (["plan", "check", "arm"], "plan without that joint (`without_joints` 6).", "(--without-joints 6)"),
        (["rezero", "arm"], "Find out by other means and name it (`causes`).", "name it (--cause)"),
        (["check", "arm"], "say what was set up anew (`new_setup`: base).", "anew (--new-setup: base)"),
    ],
)
def test_remedies_of_checks_name_options(arguments: list[str], said: str, typed: str) -> None:
    assert typed in in_words(said, parameters_by_request_name(arguments))


@pytest.fixture
def campaign(robot: str, kilter: Kilter, write_campaign: Write) -> str:
    """A campaign whose name has a space and an umlaut."""
    made = kilter.campaigns.add(robot, "Montag früh")
    kilter.campaigns.upload(made["id"], write_campaign(30))
    return str(made["name"])


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (
            ("--option", "purpose=separate"),
            "--option purpose: identify has no option 'purpose' (plan has it). It has: ",
        ),
        (("--option", "loss=3"), "--loss is 3: give linear, huber or tukey."),
        (
            ("--option", 'limits={"max_joint_deg": -3}'),
            "--option limits.max_joint_deg is -3: it should be greater than 0.",
        ),
        (("--effects", "foo"), "--effects: there is no effect 'foo'. There are: "),
        (("--effects", '{"id": "backlash", "foo": 3}'), "--effects foo: backlash has no option 'foo'. It has: joints."),
        (("--method", "foo"), "--method is 'foo': give least_squares, "),
        (("--noise-mm", "-1"), "--noise-mm is -1.0: give a number above 0 mm."),
        (("--seed", "-1"), "--seed is -1: give a whole number from 0 "),
        (("--level", "2", "--effects", "backlash"), "--level: Level 2 has no effects"),
        (("--start", "foo"), "--start: Robot "),
        (("--validation", "nobody"), "--validation: Robot "),
        (("--validation", "Montag früh"), "and in --validation: what was used to identify cannot validate."),
        (("--name", "x" * 300), "--name: the text should have at most 200 characters."),
        (("--name", "latest"), "The name 'latest' of a job looks like an id: give one "),
        (("--fix", "foo_9"), "No parameter is named 'foo_9'. There are: "),
    ],
    ids=str.split(
        "purpose loss limits effect effect-option method noise seed level start held-out same name latest fix"
    ),
)
def test_options_of_a_job(robot: str, campaign: str, capsys: Capture, more: tuple[str, ...], words: str) -> None:
    assert words in refused(capsys, "identify", robot, "--campaign", campaign, *more)


def test_options_of_other_jobs(robot: str, campaign: str, capsys: Capture) -> None:
    gap = ("gap", robot, "--campaign", campaign)
    assert "--option level: gap has no option 'level' (identify has it)" in refused(capsys, *gap, "--option", "level=2")
    assert refused(capsys, *gap, "--alpha", 2) == "--alpha is 2.0: give a number between 0 and 0.5."
    assert "name campaigns in --validation" in refused(capsys, *gap, "--validation", "folds:3")
    plan = ("plan", robot, "--purpose", "identify")
    assert refused(capsys, "plan", robot).startswith("--purpose is missing: plan needs it.")
    assert refused(capsys, *plan, "--payload-kg", -3).startswith("--payload-kg is -3.0: it should be ")
    assert "--start: Robot " in refused(capsys, *plan, "--start", "foo")
    assert "lowest corner first" in refused(capsys, *plan, "--box", "9,9,9,1,1,1", code=2)
    evaluate = ("evaluate", robot, "--campaign", campaign)
    assert refused(capsys, *evaluate, "--refit", "foo").startswith("--refit is 'foo': it should be 'base' or 'tool'.")


def test_names(robot: str, campaign: str, write_campaign: Write, capsys: Capture) -> None:
    file = write_campaign(31, "other.csv")
    taken = refused(capsys, "upload", robot, file, "--name", campaign)
    assert "has a campaign called 'Montag früh' already: give another name" in taken
    assert "add to that one with --campaign" in taken
    assert "looks like an id" in refused(capsys, "upload", robot, file, "--name", "cmp_12")
    assert run(["upload", robot, str(file), "--name", "Dienstag"]) == 0
    renamed = refused(capsys, "campaigns", "name", "Dienstag", campaign, "--robot", robot)
    assert "retire that one" in renamed
    assert "--campaign" not in renamed
    assert "Give --name Groesse" in refused(capsys, "robot", "add", "--preset", "ur10", "--name", "Größe", code=2)


def test_a_purge_of_what_is_cited(robot: str, campaign: str, kilter: Kilter, capsys: Capture) -> None:
    assert run(["identify", robot, "--campaign", campaign, "--level", "1"]) == 0
    whole = kilter.campaigns.resolve_id(campaign, robot)
    kilter.campaigns.change(whole, name="only this")
    assert f"is {whole}. Give that" in refused(capsys, "campaigns", "purge", "only this", "--yes", code=2)
    assert "`kilter measure campaigns list ROBOT` lists them" in refused(
        capsys, "campaigns", "purge", "nobody", "--yes", code=2
    )
    assert f"is cited by {robot} v1: purge" in refused(capsys, "campaigns", "purge", whole, "--yes")
    assert "1 campaign" in refused(capsys, "robot", "purge", robot, "--yes")


def test_remedies_are_commands(robot: str, tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "path.csv").write_text("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg\n0,20,30,10,5\n")
    path, out = tmp_path / "path.csv", ("-o", tmp_path / "out.csv")
    assert refused(capsys, "correct", robot, path, *out).endswith("activate one with `kilter activate VERSION`.")
    assert refused(capsys, "rollback", robot).endswith("activate one with `kilter activate VERSION`.")
    assert refused(capsys, "correct", robot, path, *out, "--format", "foo") == "--format: it should be 'ros2-yaml'."
    assert refused(capsys, "version", "ver_" + "0" * 16).endswith("list them with `kilter version list ROBOT`.")
    assert refused(capsys, "jobs", "show", "job_" + "0" * 16).endswith("list them with `kilter server jobs`.")
    assert refused(capsys, "jobs", "list", "--limit", 5000, code=2).startswith("--limit: it should be less than")
    assert refused(capsys, "identify", robot, "--loss", "x", code=2).startswith("--loss: 'x' is not one of 'linear'")


def test_places_of_no_option_stay_as_they_are() -> None:
    flags = parameters_by_request_name(["robot", "add", "arm.json"])
    assert in_words("body.rows.0.alpha_deg: Field required", flags) == "rows.0.alpha_deg: it is missing."
    assert parameters_by_request_name(["dance"]) == {}
    assert parameters_by_request_name(["versions", "arm"])["robot"] == "ROBOT"
    assert parameters_by_request_name(["campaigns", "name", "a", "b"])["name"] == "NAME"


def test_an_option_with_two_names_is_named_by_both(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["plan", "check", "ur10", "--poses", "2"]) == 2
    assert capsys.readouterr().err.startswith("Error: --poses / --count: it should be greater than or equal to 3.")
