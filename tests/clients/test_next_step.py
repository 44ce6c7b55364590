"""Each answer names the command that comes next, and the command that it names works; names stand for ids.

The arm, its files and its truth are made by ``arms_with_play``, which shares no code with Kilter.
"""

from __future__ import annotations

import re
import shlex
import socket
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from kilter_client import Kilter
from kilter_client.cli import run
from kilter_client.cli.terminal.output import begin_command, name_ids
from tests.clients.arms_with_play import ArmWithPlay

QUICK = ["--effects", "backlash,encoder_scale", "--option", "resamples=5", "--option", "bootstraps=99"]
ID = re.compile(r"\b(?:ver|cmp|job)_[0-9a-f]{16}\b")
Capture = pytest.CaptureFixture[str]


class Person:
    """Types commands, and reads which one comes next; no id of a version or a campaign is ever shown to it."""

    def __init__(self, capsys: Capture) -> None:
        self._capsys, self.said = capsys, ""

    def __call__(self, *words: object, codes: tuple[int, ...] = (0,)) -> list[str]:
        """Run a command and return the words of the one that its answer names."""
        typed = [str(one) for one in words]
        self._capsys.readouterr()
        code = run(typed)
        out, err = self._capsys.readouterr()
        assert code in codes, f"kilter {shlex.join(typed)}: {code}\n{out}{err}"
        assert not ID.search(out + err), out + err
        self.said = " ".join(out.split())
        (line,) = re.findall(r"Next(?:, if that is right)?: kilter (.*(?:\n  .*)*)", out) or [""]
        return shlex.split(line)

    def follow(self, words: list[str], begin: str, file: str = "", more: tuple[str, ...] = ()) -> list[str]:
        """Run the command that an answer named, which begins so, with a file of the person's own."""
        assert shlex.join(words).startswith(begin), words
        return self(*[file if word == "FILE" else word for word in words], *more)


@pytest.mark.timeout(600)
def test_a_person_who_types_what_each_answer_names_calibrates_an_arm(
    server: Path, capsys: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    arm, bumped, person = ArmWithPlay(6, loose=3, seed=11), ArmWithPlay(6, loose=3, seed=11), Person(capsys)
    bumped.zeros[2] += 2e-3
    path = ",".join(arm.columns) + "\n" + "\n".join(",".join(map(str, row)) for row in np.eye(6))
    for file, text in (
        ("next.urdf", arm.urdf()),
        ("grid (1).csv", arm.measured(90, 1)),
        ("unseen.csv", arm.measured(24, 2)),
        ("same.csv", arm.measured(6, 4)),
        ("hit.csv", bumped.measured(8, 5)),
        ("path.csv", path),
    ):
        (tmp_path / file).write_text(text)
    step = person("robot", "check", "next.urdf", "--base-link", "link_0", "--tip-link", "ball", "--payload-kg", "0")
    step = person.follow(step, "robot add next.urdf --payload-kg 0.0 --base-link link_0 --tip-link ball --name next")
    step = person.follow(step, "upload next FILE", "grid (1).csv")
    assert step == ["gap", "next", "--campaign", "grid (1).csv"]
    assert "campaign 'grid (1).csv': 105 rows; nothing looks wrong with them." in person.said
    step = person("upload", "next", "unseen.csv", "--name", "unseen", "--role", "validation")
    assert step == ["gap", "next", "--campaign", "grid (1).csv", "--validation", "unseen"]
    first = person("identify", "next", "-c", "grid (1).csv", "-v", "unseen")
    assert first in (["activate", "next", "v1"], step)  # whether more than noise is left
    activate = person.follow(step, "gap next", more=tuple(QUICK))
    assert person("version", "show", "next", "v2") == activate
    assert "effects: backlash" in person.said
    assert person("version", "evaluate", "next", "-c", "unseen", "--version", "next v2") == activate
    step = person.follow(activate, "activate next v2")
    ((poses, before, after),) = re.findall(r"on (\d+) poses that no fit used: (\S+) -> (\S+) mm\.", person.said)
    assert int(poses) == 24
    assert float(after) < 0.2 * float(before)
    step = person.follow(step, "correct next FILE -o corrected.csv", "path.csv")
    assert re.search(r"corrected.csv: 6 rows, largest change \S+ mm.*; corrected with next v2\.", person.said)
    assert person.follow(step, "plan check next", more=("--poses", "6")) == ["check", "next", "FILE"]
    evaluate = person("upload", "next", "unseen.csv", "--name", "unseen", "--role", "validation")
    today = person.follow(evaluate, "version evaluate next --campaign unseen")
    assert person("version", "show", "next", "v2") == today
    step = person("version", "residuals", "next", "v2", "-o", "left.csv")
    person.follow(step, "measure suspicious 'grid (1).csv' --robot next")
    assert person("check", "next", "same.csv") == today
    assert person.follow(today, "today next")[:2] == ["plan", "check"]
    rezero = person("check", "next", "hit.csv", codes=(3,))
    assert person.said.startswith("moved: zero of joint 3 by 0.1")
    assert 0.5 < float(re.findall(r"Measured and predicted are (\S+) mm apart", person.said)[0]) < 3.0  # 2 mrad at 1 m
    assert person("server", "jobs", "show", "latest", "--robot", "next") == rezero
    assert person("today", "next") == rezero
    person.follow(rezero, "watch rezero next --campaign hit.csv")


def test_lists_and_errors_name_what_has_an_id(server: Path, capsys: Capture, tmp_path: Path) -> None:
    arm, person = ArmWithPlay(6, seed=12), Person(capsys)
    (tmp_path / "called.urdf").write_text(arm.urdf())
    (tmp_path / "rows.csv").write_text(arm.measured(40, 1))
    person("robot", "add", tmp_path / "called.urdf", "--base-link", "link_0", "--tip-link", "ball", "--name", "called")
    person("upload", "called", tmp_path / "rows.csv", "--name", "rows")
    person("identify", "called", "-c", "rows", "--name", "first")
    for words in (("measure", "campaigns", "called"), ("version", "list", "called"), ("server", "jobs")):
        person(*words)
    with Kilter() as kilter:
        (version,), (campaign,) = kilter.versions.list("called"), kilter.campaigns.list("called")
        (job,) = kilter.jobs.list("called")
    assert name_ids(f"{version['id']} of {job['id']}, {campaign['id']} 'rows'.") == "called v1 of first, rows."
    assert name_ids("cmp_0123456789abcdef") == "cmp_0123456789abcdef"  # nobody's
    person("measure", "campaigns", "name", "rows", "new rows", "--robot", "called")
    person("version", "show", "called", "v1")
    assert "train: campaign 'new rows'," in person.said  # not as it was called then
    person("version", "retire", version["id"])
    capsys.readouterr()
    assert run(["activate", version["id"]]) == 1
    assert "called v1 is retired" in capsys.readouterr().err
    assert run(["activate", version["id"], "--json"]) == 1
    assert version["id"] in capsys.readouterr().out


def test_names_are_not_waited_for_where_a_server_hangs(
    server: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked = 0
    with socket.create_server(("127.0.0.1", 0)) as silent:  # takes connections and never answers
        monkeypatch.setenv("KILTER_URL", f"http://127.0.0.1:{silent.getsockname()[1]}")
        monkeypatch.setenv("KILTER_TOKEN", "x")
        begin_command()
        text = " ".join(f"ver_{k:016x}" for k in range(40))
        begun = time.monotonic()
        assert name_ids(text) == text
        waited = time.monotonic() - begun
        silent.settimeout(0.2)
        with suppress(TimeoutError):
            while asked < 40:
                silent.accept()[0].close()
                asked += 1
    assert asked == 1  # not once for each of forty
    assert waited < 40.0  # a minute for each would be 40 minutes
