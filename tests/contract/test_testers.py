"""Tests that are shared among forks all run once, module by module, and what kills a fork costs one test."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
CONFTEST = """
from tests.testers import Testers

def pytest_configure(config): config.pluginmanager.register(Testers(2))
"""
MODULE = """
import os, pathlib, pytest, time

RAN = pathlib.Path(__file__).with_name("ran")

def note(name, tmp_path):
    with RAN.open("a") as file:
        file.write(f"{os.getpid()} {os.getppid()} {__name__} {name} {tmp_path.parent.name}\\n")

@pytest.fixture(scope="session", autouse=True)
def session():
    yield
    note("end", RAN)

def test_one(tmp_path): note("one", tmp_path); time.sleep(0.3)
def test_two(tmp_path): note("two", tmp_path)
"""
FAILING = (
    MODULE
    + """
def test_wrong(tmp_path):
    print("what it printed")
    note("wrong", tmp_path)
    assert "left" == "right"

def test_crash(tmp_path): os.kill(os.getpid(), 9)
def test_after(tmp_path): note("after", tmp_path)
"""
)


def run_testers(
    folder: Path, modules: dict[str, str], *arguments: str
) -> tuple[subprocess.CompletedProcess[str], list[list[str]]]:
    """What pytest said of modules with two testers, and of each test its process, its parent, module, name and folder."""
    (folder / "conftest.py").write_text(CONFTEST)
    for name, text in modules.items():
        (folder / f"test_{name}.py").write_text(text)
    command = [sys.executable, "-m", "pytest", "-c", "/dev/null", f"--rootdir={folder}", *arguments, str(folder)]
    plain = os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done = subprocess.run(command, cwd=REPOSITORY, env=plain, capture_output=True, text=True, timeout=240, check=False)
    return done, [line.split() for line in (folder / "ran").read_text().splitlines()]


def test_each_test_runs_once_in_one_of_the_forks_with_those_of_its_module(tmp_path: Path) -> None:
    done, ran = run_testers(tmp_path, dict.fromkeys("abcd", MODULE))
    assert done.returncode == 0, done.stdout + done.stderr
    assert "8 passed" in done.stdout
    tests = [row for row in ran if row[3] != "end"]
    assert Counter((row[2][-1], row[3]) for row in tests) == Counter((m, t) for m in "abcd" for t in ("one", "two"))
    processes = {row[2]: {other[0] for other in tests if other[2] == row[2]} for row in tests}
    assert all(len(of_module) == 1 for of_module in processes.values())
    assert len({row[0] for row in tests}) == 2
    assert len({row[1] for row in tests}) == 1
    assert {row[4] for row in tests} == {"tester0", "tester1"}
    assert Counter(row[0] for row in ran if row[3] == "end").keys() == {row[0] for row in tests}  # fixtures end in each


def test_a_failure_is_reported_with_its_output_and_a_crash_costs_one_test(tmp_path: Path) -> None:
    done, ran = run_testers(tmp_path, {"a": FAILING, "b": MODULE}, "-v")
    assert done.returncode == 1, done.stdout + done.stderr
    assert "2 failed, 5 passed" in done.stdout
    assert re.search(r"assert 'left' == 'right'.*Captured stdout call[ -]*\nwhat it printed", done.stdout, re.DOTALL)
    assert "test_a.py::test_crash ended with exit code -9" in done.stdout
    assert Counter(row[3] for row in ran if row[3] != "end") == {"one": 2, "two": 2, "wrong": 1, "after": 1}


def test_the_first_failure_ends_all_where_that_is_asked_for(tmp_path: Path) -> None:
    slow = MODULE.replace("0.3", "60")
    done, ran = run_testers(tmp_path, {"a": FAILING.replace("0.3", "0"), "b": slow}, "-x")
    assert done.returncode == 1, done.stdout + done.stderr
    assert "stopping after 1 failures" in done.stdout
    assert "after" not in {row[3] for row in ran}
    assert any(row[2].endswith("b") and row[3] == "end" for row in ran)  # what its fixtures started is ended


@pytest.mark.parametrize("asked", ["--collect-only"])
def test_what_only_lists_tests_forks_none(tmp_path: Path, asked: str) -> None:
    (tmp_path / "ran").touch()
    done, ran = run_testers(tmp_path, {"a": MODULE}, asked)
    assert (done.returncode, ran) == (0, [])
    assert "test_one" in done.stdout
