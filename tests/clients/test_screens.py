"""What the everyday commands print fits on a screen, on arms of six to twelve axes; its headline says what is true.

The arms, their files and their truth are made by ``arms_with_play``, which shares no code with Kilter.
"""

from __future__ import annotations

import json
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kilter_client.cli import run
from kilter_client.cli.reports.answer import fit_messages, format_answer
from kilter_client.cli.reports.results import show_job, show_today
from kilter_client.cli.stored.versions import _show_diff
from kilter_client.cli.terminal import output
from kilter_client.cli.terminal.output import is_note_due
from tests.clients.arms_with_play import ArmWithPlay

LINES, COLUMNS = 25, 120
QUICK = ("--effects", "backlash,encoder_scale,eccentricity", "--option", "resamples=5", "--option", "bootstraps=99")
ARMS = {"six": ArmWithPlay(6), "seven": ArmWithPlay(7), "railed": ArmWithPlay(8, rail=True), "twelve": ArmWithPlay(12)}
Capture = pytest.CaptureFixture[str]


class Screen:
    """A terminal that keeps what a command printed that does not fit."""

    def __init__(self, capsys: Capture) -> None:
        self.capsys, self.too_much = capsys, list[str]()

    def __call__(self, *arguments: object, codes: tuple[int, ...] = (0,)) -> str:
        words = [str(one) for one in arguments]
        self.capsys.readouterr()
        code = run(words)
        out, err = self.capsys.readouterr()
        assert code in codes, out + err
        lines = (err + out).splitlines()
        if len(lines) > LINES or max(map(len, lines), default=0) > COLUMNS:
            said = f"{len(lines)} lines, {max(map(len, lines))} columns"
            self.too_much.append(f"kilter {' '.join(words)}: {said}\n{err}{out}")
        return out


@pytest.fixture(autouse=True)
def usual_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(output, "WIDE", COLUMNS)


@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ARMS)
def test_every_answer_fits_on_a_screen_and_its_headline_is_true(
    name: str, server: Path, capsys: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm, screen = ARMS[name], Screen(capsys)
    monkeypatch.chdir(tmp_path)
    for file, text in (
        ("arm.urdf", arm.urdf()),
        ("measured.csv", arm.measured(90, 1)),
        ("unseen.csv", arm.measured(24, 2)),
        ("later.csv", arm.measured(6, 4)),
    ):
        (tmp_path / file).write_text(text)
    described = ("arm.urdf", "--name", name, "--base-link", "link_0", "--tip-link", "ball")
    assert screen("robot", "check", *described).startswith(f"{name}: {arm.axes} axes, reach ")
    added = screen("robot", "add", *described)
    assert f"Check once whether {name}'s controller corrects by itself" in added
    screen("inspect", "measured.csv", "--robot", name)
    screen("upload", name, "measured.csv", "--dry-run")
    screen("upload", name, "measured.csv", "--name", "measured")
    screen("upload", name, "unseen.csv", "--name", "unseen", "--role", "validation")
    both = ("--campaign", "measured", "--validation", "unseen")
    screen("identify", name, *both, "--check")
    screen("gap", name, *both, "--check")
    screen("identify", name, *both)
    said = screen("gap", name, *both, *QUICK)
    assert said.startswith(f"Found: reversal error of joint {arm.loose}, like backlash (")  # or wound up by friction
    (size,) = re.findall(r"backlash +\d+ +(\S+) to (\S+) deg .*certain", said)
    low, high = sorted(abs(float(end)) for end in size)
    assert low <= 2.0 * arm.loose_play_deg <= high < 1.1 * low
    before, after = map(float, re.findall(r"unseen poses: (\S+) -> (\S+) mm", said)[0])
    assert after < 0.5 * before
    activated = screen("activate", "latest", "--robot", name)
    assert activated.startswith(f"{name} v2 is active.")
    assert f"whether {name}'s controller" not in activated  # said as the robot was added
    for arguments in (
        ("version", "latest", "--robot", name),
        ("versions", name),
        ("jobs", "list", "--robot", name),
        ("jobs", "show", "latest", "--robot", name),
        ("campaigns", name),
        ("today", name),
        ("diff", "nominal", "latest", "--robot", name),
        ("drift", name),
        ("activations", name),
        ("plan", "check", name, "--poses", "6", "-o", "check.csv"),
        ("suspicious", "measured", "--robot", name),
        ("robot", "list"),
        ("robot", "show", name),
        ("server", "status"),
        ("server", "audit"),
        ("version", "residuals", "latest", "--robot", name, "-o", "residuals.csv"),
        ("version", "export", "latest", "--robot", name, "--format", "dh-csv", "-o", "arm.csv"),
    ):
        screen(*arguments)
    evaluated = screen("evaluate", name, "--campaign", "unseen", "--version", "latest")
    (before, after) = map(float, re.findall(r"^Mean error on \d+ rows of unseen.*: (\S+) -> (\S+) mm", evaluated)[0])
    assert after < 0.1 * before
    screen("check", name, "later.csv", codes=(0, 3, 4))
    np.savetxt("path.csv", np.zeros((3, arm.axes)), delimiter=",", header=",".join(arm.columns), comments="")
    screen("correct", name, "path.csv", "-o", "corrected.csv")
    assert not screen.too_much, "\n\n".join(screen.too_much)


CAUSE = "The third joint of this arm turns further than its encoder says, by an amount that grows with the load. " * 3
REMEDY = "Look at its coupling, and say so with `kilter watch repair arm j3`."


@pytest.mark.parametrize("room", [2, 4, 6, 20])
def test_the_remedy_of_a_warning_is_never_cut(room: int) -> None:
    lines = fit_messages([f"Warning: {CAUSE}{REMEDY}"] * 2, COLUMNS, room)
    assert len(lines) <= max(room, 3)
    assert max(map(len, lines)) <= COLUMNS
    shown = " ".join(line.strip() for line in lines)
    assert REMEDY in shown
    assert "... " not in shown or f"... {REMEDY.strip()}" in shown  # what is left begins with a sentence
    assert shown.count(REMEDY) == 2 or "and 1 more (--details)" in shown


def test_a_note_on_how_rows_were_sent_is_shown_once_and_a_finding_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    warnings = [{"code": "directions_derived", "message": "a note"}, {"code": "repeats_drift", "message": "a finding"}]
    job = {"kind": "gap", "robot": "arm", "state": "succeeded", "result": {"headline": "x", "warnings": warnings}}
    said = []
    for robot, server in (("arm", "one"), ("arm", "one"), ("other", "one"), ("arm", "")):
        show_job(job | {"robot": robot}, details=False, head=False, server=server)
        said.append(capsys.readouterr().out)
    assert ["a note" in one for one in said] == [True, False, True, True]  # asked for again, it is told again
    assert all("a finding" in one for one in said)


def test_a_cause_that_the_headline_names_is_not_said_again_in_a_table() -> None:
    cause = {"words": "zero of joint 3", "refuted": False, "numbers": [{"u95": 0.01, "change": 0.1, "unit": "deg"}]}
    other = cause | {"words": "base"}
    refuted = cause | {"words": "tool", "refuted": True}
    alone = format_answer({"headline": "moved", "verdict": "moved", "looked_at": [cause, refuted]}, [], COLUMNS)
    assert alone == ["moved"]
    both = {"headline": "cannot tell", "verdict": "cannot_tell", "looked_at": [cause, other, refuted]}
    lines = format_answer(both, [], COLUMNS)
    assert ["zero of joint 3" in " ".join(lines), "base" in " ".join(lines), "tool" in " ".join(lines)] == [
        True, True, False,
    ]  # fmt: skip


def test_a_table_has_no_empty_column_and_large_numbers_no_exponent() -> None:
    found = [{"effect": "spring", "joints": [2], "size": "3 N m", "moves_mm": None, "sure": "certain"}]
    lines = format_answer({"headline": "Found", "found": found}, [], COLUMNS)
    assert "moves tool by" not in " ".join(lines)
    assert "spring" in " ".join(lines)
    assert [output.number(value, 3) for value in (1746.2, 0.03278, 12.34, 999.7)] == ["1746", "0.0328", "12.3", "1000"]


def test_a_comparison_of_versions_fits_a_screen_and_masses_that_were_carried_come_last(capsys: Capture) -> None:
    def changed(name: str) -> dict[str, Any]:
        return {"name": name, "a": 0.0, "b": 1.0, "change": 1.0, "unit": "mm", "moved": True}

    masses = [changed(f"link_mass_{k}") for k in range(20)]
    document = {"a": "ver_1", "b": "ver_2", "effects_added": ["load_error"], "effects_removed": []}
    _show_diff(document | {"parameters": [*masses, changed("backlash_4"), changed("d_2") | {"moved": False}]})
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= LINES
    rows = [line.split()[0] for line in lines if line.startswith((" backlash", " link_mass"))]
    assert rows == ["backlash_4", *(f"link_mass_{k}" for k in range(11))]
    assert lines[-1] == "9 more differ, and 1 differ by less than their uncertainty or not at all; --json has them."


def test_a_refusal_fits_the_columns_of_a_screen(server: Path, capsys: Capture) -> None:
    assert run(["gap", "arm", "-c", "x", "--option", f"effects={'y' * 90}", "--option", f"{'z ' * 60}"]) != 0
    assert run(["robot", "show", "an arm with a name of many words, each of which is short " * 3]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1].strip()
    assert max(map(len, [line for line in lines if "y" * 90 not in line])) <= COLUMNS


def test_details_of_a_check_draw_the_arm(server: Path, capsys: Capture, tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(ARMS["twelve"].urdf())
    command = ["robot", "check", str(tmp_path / "arm.urdf"), "--base-link", "link_0", "--tip-link", "ball"]
    assert run([*command, "--details"]) == 0
    assert "from above: x to the right" in capsys.readouterr().out


def test_a_note_is_shown_again_for_another_cause_and_after_the_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert is_note_due("http://one", "a is unknown")
    assert not is_note_due("http://one", "a is unknown")
    assert is_note_due("http://two", "a is unknown")
    assert is_note_due("http://one", "b is unknown")
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now + 13 * 3600)
    assert is_note_due("http://one", "a is unknown")


def test_details_and_json_hold_all_that_an_answer_leaves_out(server: Path, capsys: Capture, tmp_path: Path) -> None:
    arm, screen = ArmWithPlay(6, loose=2), Screen(capsys)
    (tmp_path / "arm.urdf").write_text(arm.urdf())
    (tmp_path / "rows.csv").write_text(arm.measured(60, 1))
    screen("robot", "add", tmp_path / "arm.urdf", "--name", "whole", "--base-link", "link_0", "--tip-link", "ball")
    screen("upload", "whole", tmp_path / "rows.csv", "--name", "rows")
    job = json.loads(screen("identify", "whole", "-c", "rows", "-v", "0.25", "--json"))
    short = screen("jobs", "show", job["id"])
    long = screen("jobs", "show", job["id"], "--details")
    assert "observability:" not in short
    assert "observability:" in long
    assert "theta_offset_2" in long
    assert all(line in " ".join(short.split()) for line in job["result"]["headline"].splitlines())
    assert job["result"]["parameters"]


def test_today_of_a_busy_robot_fits_on_a_screen(capsys: Capture) -> None:
    sentences = [f"Check {k} of arm: {CAUSE}{REMEDY}" for k in range(40)]
    standing = {"words": "Not known", "sentence": "Nobody has checked it.", "steps": [{"command": "kilter check arm"}]}
    show_today({"robot": "arm", "version_id": None, "newest": None, "sentences": sentences, "standing": standing})
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= LINES
    assert max(map(len, lines)) <= COLUMNS
    assert lines[0] == "Not known. Nobody has checked it."
    assert lines[1].startswith("Check 0 of arm")
    assert any(re.search(r"and \d+ more \(all: --json\)", line) for line in lines)
