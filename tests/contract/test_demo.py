"""The demo runs from start to end and shows what it promises: the end-to-end test of the whole job."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
DEADLINE_S = 180
CIRCLE_S = 3  # 8 when nobody says how fast: the path is solved and streamed point by point


def run_demo(*arguments: str) -> str:
    done = subprocess.run(
        [Path(sys.executable).with_name("kilter"), "demo", "--circle-s", str(CIRCLE_S), *arguments],
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    assert done.stderr == ""
    return done.stdout


@pytest.fixture(scope="module")
def output() -> str:
    return run_demo()


def figures(output: str, name: str) -> list[float]:
    found = re.search(rf"^{name} +([\d. ]+)$", output, re.MULTILINE)
    assert found, output
    return [float(figure) for figure in found[1].split()]


def test_full_tilting_reaches_the_noise_on_held_out_poses(output: str) -> None:
    before, conventional = figures(output, "before")[3], figures(output, "conventional")[3]
    stiffness, full = figures(output, "stiffness only")[3], figures(output, "full tilting")[3]
    assert before > conventional > stiffness > full
    assert full <= 0.020


def test_the_streamed_circle_is_corrected() -> None:
    document = json.loads(run_demo("--json"))
    before, after = document["before_mm"], document["after_mm"]
    assert len(before) == len(after) == 500 * CIRCLE_S + 1
    assert sum(after) < 0.1 * sum(before)


def test_it_names_what_to_try_next(output: str) -> None:
    named = re.findall(r"docs/\S+\.md", output)
    assert named
    assert all((REPOSITORY / page).is_file() for page in named)
