"""Ctrl-C in the middle of a command: what is stored is said, nobody reads a traceback, the exit code is 130."""

from __future__ import annotations

import json
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from kilter_client import Kilter
from kilter_client.cli import run

Write = Callable[..., Path]
Capture = pytest.CaptureFixture[str]
PROGRAM = Path(sys.executable).with_name("kilter")


def started(*arguments: str) -> subprocess.Popen[str]:
    """Start the installed command as from a shell, where Ctrl-C is on."""
    return subprocess.Popen(
        [PROGRAM, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


MANY = 20_000  # draws of a search, which is then not over before the interruption on a slow machine either


def interrupted(process: subprocess.Popen[str]) -> tuple[str, str]:
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    return out, err


@pytest.mark.parametrize("command", ["gap", "watch"])
def test_while_a_job_runs(robot: str, kilter: Kilter, write_campaign: Write, command: str) -> None:
    campaign = kilter.campaigns.add(robot, "monday")["id"]
    kilter.campaigns.upload(campaign, write_campaign(400))
    if command == "watch":
        job = kilter.jobs.submit("gap", robot, [campaign], options={"bootstraps": MANY})["id"]
        process = started("server", "jobs", "watch", "latest", "--robot", robot)
        assert process.stderr is not None
        assert process.stderr.readline() == f"job 'latest' is {kilter.jobs.get(job)['name']!r}\n"
        while kilter.jobs.get(job)["state"] == "queued":
            continue
    else:
        process = started("gap", robot, "--campaign", "monday", "--option", f"bootstraps={MANY}")
        assert process.stderr is not None
        job = kilter.resolve("job", process.stderr.readline().removeprefix("job: ").strip()).id
    err = " ".join(interrupted(process)[1].split())
    named = shlex.quote(kilter.jobs.get(job)["name"]) if command != "watch" else job
    assert re.search(rf"job ({re.escape(named)}|'[^']*') continues at the server", err)
    assert re.search(r"`kilter server jobs watch [^`]+` follows it, `kilter server jobs cancel [^`]+` stops it\.", err)
    # The interruption stopped nothing: the job goes on, or is over on a machine that was slow to end the command, also while
    # it is asked to stop.
    assert kilter.jobs.get(job)["state"] in ("queued", "running", "succeeded")
    assert run(["jobs", "cancel", job]) == 0 or kilter.jobs.get(job)["state"] == "succeeded"


def test_as_soon_as_the_job_is_known(
    robot: str, kilter: Kilter, write_campaign: Write, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign = kilter.campaigns.add(robot, "monday")["id"]
    kilter.campaigns.upload(campaign, write_campaign(60))
    job = kilter.jobs.submit("gap", robot, [campaign])["id"]
    monkeypatch.setattr("kilter_client.cli.jobs.note", pressed)  # while the line "job 'latest' is ..." is written
    assert run(["jobs", "watch", "latest", "--robot", robot]) == 130
    assert f"job {job} continues at the server" in capsys.readouterr().err
    kilter.jobs.cancel(job)


def test_with_json_it_is_one_document(robot: str, kilter: Kilter, write_campaign: Write) -> None:
    campaign = kilter.campaigns.add(robot, "monday")["id"]
    kilter.campaigns.upload(campaign, write_campaign(60))
    process = started("gap", robot, "--campaign", "monday", "--json")
    while not kilter.jobs.list(robot):
        continue
    job = kilter.jobs.list(robot)[0]["id"]
    out, err = interrupted(process)
    assert err == ""
    assert json.loads(out)["code"] == "interrupted"
    kilter.jobs.cancel(job)


TWO_PIECES = 3500  # poses of a file that is not whole at the server when its first piece has gone


@pytest.fixture
def broken_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """The person presses Ctrl-C when the first bytes of an upload have gone."""

    @contextmanager
    def bar(*_: object) -> Iterator[Callable[[int, int], None]]:
        def press(*_: object) -> None:
            raise KeyboardInterrupt

        yield press

    monkeypatch.setattr("kilter_client.cli.files.sending.upload_bar", bar)


def test_while_a_campaign_is_sent(
    robot: str,
    kilter: Kilter,
    write_campaign: Write,
    broken_off: None,
    capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    file = write_campaign(TWO_PIECES)
    assert run(["upload", robot, str(file)]) == 130
    assert "Interrupted: nothing is stored. The same command sends the file again." in capsys.readouterr().err
    assert kilter.campaigns.list(robot, staged=True) == kilter.campaigns.list(robot) == []
    monkeypatch.undo()
    monkeypatch.setenv("KILTER_URL", kilter.url)
    monkeypatch.setenv("KILTER_TOKEN", kilter._connection._place.token or "")
    assert run(["upload", robot, str(file)]) == 0
    assert len(kilter.campaigns.list(robot)) == 1


def test_while_rows_are_added(
    robot: str, kilter: Kilter, write_campaign: Write, broken_off: None, capsys: Capture
) -> None:
    campaign = kilter.campaigns.add(robot, "monday")["id"]
    arguments = ["upload", robot, str(write_campaign(TWO_PIECES)), "--campaign", "monday"]
    assert run(arguments) == 130
    assert f"nothing is added to campaign {campaign}. The same command sends the file again." in capsys.readouterr().err
    assert kilter.campaigns.get(campaign)["uploads"] == []
    kilter.campaigns.upload(campaign, write_campaign(TWO_PIECES))
    assert run(arguments) == 130
    assert f"the rows are stored in campaign {campaign}." in capsys.readouterr().err


def pressed(*_: Any, **__: Any) -> Any:
    raise KeyboardInterrupt


def test_while_a_path_is_corrected(
    server: Path, robot: str, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, out = tmp_path / "path.csv", tmp_path / "out.csv"
    path.write_text("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg\n0,20,30,10,5\n")
    monkeypatch.setattr(Kilter, "correct", pressed)
    assert run(["correct", robot, str(path), "-o", str(out)]) == 130
    assert f"Interrupted: {out} is not written." in capsys.readouterr().err
    assert not out.exists()


def test_anywhere_else(server: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Kilter, "health", pressed)
    assert run(["status"]) == 130
    assert "Interrupted. The server finishes what it had begun" in capsys.readouterr().err
    assert run(["status", "--json"]) == 130
    assert json.loads(capsys.readouterr().out)["code"] == "interrupted"
