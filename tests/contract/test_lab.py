"""The Makefile is short, and every experiment of the laboratory runs what there is, under a name that the texts use."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tools.lab import EXPERIMENTS, find_command, list_experiments, main

REPOSITORY = Path(__file__).resolve().parents[2]
MAKEFILE = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
NAMED = re.compile(r"tools\.lab (?!import )([a-z][a-z0-9-]*)")


def test_make_has_at_most_fifteen_targets() -> None:
    targets = re.findall(r"^([a-z-]+):.*## ", MAKEFILE, re.MULTILINE)
    assert len(targets) <= 15
    assert {"setup", "serve", "demo", "test", "check", "fmt", "bench", "page", "wheels", "image", "clean"} <= set(
        targets
    )


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_an_experiment_runs_what_there_is(name: str) -> None:
    program, *words = find_command(name, ["--given"])
    assert words[-1] == "--given"
    if program == sys.executable:
        module = words[words.index("-m") + 1]
        assert importlib.util.find_spec(module) is not None
    else:
        assert program in ("sh", "make")
    paths = [word for word in words if re.match(r"(tests|tools)/", word)]
    assert all((REPOSITORY / path).exists() for path in paths), paths
    if environment := EXPERIMENTS[name].environment:
        assert f"\n{environment}/.ready:" in MAKEFILE


def test_all_are_listed_with_how_long_they_take() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tools.lab"], cwd=REPOSITORY, capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.strip() == list_experiments()
    rows = {line.split()[0]: line for line in done.stdout.splitlines()[1:]}
    assert rows.keys() == EXPERIMENTS.keys()
    for name, one in EXPERIMENTS.items():
        assert f"{one.subject} ({one.duration})" in rows[name]


def test_a_name_that_is_none_is_refused_with_the_way_to_the_names(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["kill"]) == 2
    assert "There is no experiment 'kill'. `python -m tools.lab` lists them." in capsys.readouterr().err


def test_texts_name_experiments_that_there_are() -> None:
    listed = subprocess.run(
        ["git", "ls-files"], cwd=REPOSITORY, capture_output=True, text=True, check=True
    ).stdout.split()
    texts = [REPOSITORY / name for name in listed if name.endswith((".md", ".in", ".py", ".c", ".toml", ".txt"))]
    named = {name for path in texts if path.is_file() for name in NAMED.findall(path.read_text(encoding="utf-8"))}
    assert len(named) > 20
    assert named <= EXPERIMENTS.keys()
