"""The demo runs from start to end and shows what it promises: the end-to-end test of the whole job."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from kilter_client.cli import demo, run
from kilter_client.requests.connection import local_server
from tests.service.forked import ForkedPopen

REPOSITORY = Path(__file__).resolve().parents[2]
DEADLINE_S = 180
CIRCLE_S = 3  # 8 when nobody says how fast: the path is solved and streamed point by point


@pytest.fixture(scope="module")
def output() -> str:
    """What the demo prints as a program of its own, which starts its server as a person's does."""
    command = [Path(sys.executable).with_name("kilter"), "demo", "--circle-s", str(CIRCLE_S)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    assert done.stderr == ""
    return done.stdout


def figures(output: str, name: str) -> list[float]:
    found = re.search(rf"^{name} +([\d. ]+)$", output, re.MULTILINE)
    assert found, output
    return [float(figure) for figure in found[1].split()]


def test_full_tilting_reaches_the_noise_on_held_out_poses(output: str) -> None:
    before, conventional = figures(output, "before")[3], figures(output, "conventional")[3]
    stiffness, full = figures(output, "stiffness only")[3], figures(output, "full tilting")[3]
    assert before > conventional > stiffness > full
    assert full <= 0.020


def test_the_streamed_circle_is_corrected(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "local_server", partial(local_server, start=ForkedPopen))
    assert run(["demo", "--circle-s", str(CIRCLE_S), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    before, after = document["before_mm"], document["after_mm"]
    assert len(before) == len(after) == 500 * CIRCLE_S + 1
    assert sum(after) < 0.1 * sum(before)


def test_it_names_what_to_try_next(output: str) -> None:
    named = re.findall(r"docs/\S+\.md", output)
    assert named
    assert all((REPOSITORY / page).is_file() for page in named)
