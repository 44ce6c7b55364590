"""Processor time is counted by module, across processes and phases."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests import measured_seconds
from tests.measured_seconds import Row, Took, rows_of

REPOSITORY = Path(__file__).resolve().parents[2]
LIGHT = "tests/core/arm/test_compiled.py::"  # which compile, whatever the machine
QUIET = {name: value for name, value in os.environ.items() if name != "PYTEST_ADDOPTS"}  # the lines are read
BUSY = "import time\nend = time.process_time() + {}\nwhile time.process_time() < end: pass\n"
MODULE = """
import subprocess, sys, pytest

@pytest.fixture(scope="module")
def work():
    subprocess.run([sys.executable, "-c", {busy!r}], check=True)

@pytest.fixture(scope="module")
def child(work):
    yield
    subprocess.run([sys.executable, "-c", {busy!r}], check=True)

def test_it(child): pass
"""


@pytest.mark.parametrize("shared", [[], ["-n", "2", "--dist", "loadscope"]], ids=["alone", "shared"])
def test_a_child_counts_where_it_ends(tmp_path: Path, shared: list[str]) -> None:
    (tmp_path / "test_busy.py").write_text(MODULE.format(busy=BUSY.format(0.6)))
    for name in ("test_idle.py", *(f"test_last_{k}.py" for k in range(4))):  # what a last test ends is the session's
        (tmp_path / name).write_text("import time\ndef test_it(): time.sleep(0.6)\n")
    (tmp_path / "conftest.py").write_text(
        "from tests.cpu_seconds import CpuSeconds\n"
        "def pytest_configure(config): config.pluginmanager.register(CpuSeconds())\n"
    )
    alone = ["-p", "xdist", "-c", "/dev/null", f"--rootdir={tmp_path}"]
    command = [sys.executable, "-m", "pytest", *alone, *shared, str(tmp_path)]
    plain = os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}  # three processes would import hypothesis and others
    done = subprocess.run(command, cwd=REPOSITORY, env=plain, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    took = {name: float(seconds) for seconds, name in re.findall(r"^ +([\d.]+)  (\S+\.py)$", done.stdout, re.MULTILINE)}
    assert took["test_busy.py"] >= 1.2
    assert took["test_idle.py"] < 0.6
    (child,) = re.findall(r"^ +([\d.]+)  work \(test_busy\.py\)$", done.stdout, re.MULTILINE)
    assert 0.6 <= float(child) < took["test_busy.py"]


def test_what_takes_long_is_left_to_the_gate_but_for_the_shortest_of_a_module_without_others() -> None:
    tests = {
        "a.py::test_short": 0.5, "a.py::test_long": 3.0,
        "b.py::test_long": 4.0, "b.py::test_longer": 5.0,
        "c.py::test_longest": 20.0,
        "d.py::test_of_a_long_fixture": 1.5,
    }  # fmt: skip
    fixtures = {"a.py": 0.0, "b.py": 1.2, "c.py": 0.0, "d.py": 9.0}
    rows = rows_of({name: Took(s, s) for name, s in tests.items()}, {name: Took(s, s) for name, s in fixtures.items()})
    assert {row.name for row in rows if row.is_long} == {
        "a.py::test_long",
        "b.py::test_longer",
        "c.py::test_longest",
        "d.py",
    }
    assert "b.py" in {row.name for row in rows}
    assert "a.py::test_short" not in {row.name for row in rows}  # too short to be written down


def test_what_is_written_down_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "tests").mkdir()
    monkeypatch.setattr(measured_seconds, "SECONDS", tmp_path / "tests" / "seconds.txt")
    assert measured_seconds.measured() == []
    rows = [Row(Took(12.3, 45.6), True, "a.py::test_it[one two]"), Row(Took(1.0, 2.0), False, "b.py")]
    measured_seconds.write(rows, ["a.py", "b.py"])
    assert measured_seconds.measured() == rows
    (tmp_path / "a.py").touch()  # a run of some modules leaves the rows of others, but of those that are gone
    more = Row(Took(3.0, 4.0), True, "c.py::test_it")
    measured_seconds.write([more], ["c.py"])
    assert measured_seconds.measured() == [rows[0], more]
    measured_seconds.write([], ["a.py"])
    assert measured_seconds.measured() == []  # a.py has become quick, and there is no c.py


def test_a_long_test_waits_for_its_target_unless_it_is_asked_for_by_name() -> None:
    # One whose module imports little: it is imported three times.
    name = next(row.name for row in measured_seconds.measured() if row.is_long and row.name.startswith(LIGHT))
    for asked, marks, found in [
        (name.partition("::")[0], "not long", False),
        (name.partition("::")[0], "long", True),
        (name, "not long", True),
    ]:
        command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider", "-m", marks, asked]
        done = subprocess.run(
            command, cwd=REPOSITORY, env=QUIET, capture_output=True, text=True, timeout=240, check=False
        )
        assert (name in done.stdout.splitlines()) is found, done.stdout + done.stderr
