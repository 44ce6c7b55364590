"""Processor time is counted by module, across processes and phases."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
BUSY = "import time\nend = time.process_time() + {}\nwhile time.process_time() < end: pass\n"
MODULE = """
import subprocess, sys, pytest

@pytest.fixture(scope="module")
def child():
    yield
    subprocess.run([sys.executable, "-c", {busy!r}], check=True)

def test_it(child): pass
"""


@pytest.mark.parametrize("shared", [[], ["-n", "2", "--dist", "loadscope"]], ids=["alone", "shared"])
def test_a_child_counts_where_it_ends(tmp_path: Path, shared: list[str]) -> None:
    (tmp_path / "test_busy.py").write_text(MODULE.format(busy=BUSY.format(0.6)))
    (tmp_path / "test_idle.py").write_text("import time\ndef test_it(): time.sleep(0.6)\n")
    (tmp_path / "conftest.py").write_text(
        "from tests.cpu_seconds import CpuSeconds\n"
        "def pytest_configure(config): config.pluginmanager.register(CpuSeconds())\n"
    )
    command = [sys.executable, "-m", "pytest", "-c", "/dev/null", f"--rootdir={tmp_path}", *shared, str(tmp_path)]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    took = {name: float(seconds) for seconds, name in re.findall(r"^ +([\d.]+)  (\S+\.py)$", done.stdout, re.MULTILINE)}
    assert took["test_busy.py"] >= 0.6
    assert took["test_idle.py"] < 0.6
