"""The package loads little, so that scripts and the command start fast."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("httpx", "rich", "numpy", "scipy", "pyarrow", "zenoh", "anyio", "ssl")


def loaded(code: str) -> set[str]:
    """Return which of the heavy packages a fresh interpreter has loaded after ``code``."""
    script = f"import sys\n{code}\nprint(*[name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split())


@pytest.mark.parametrize(
    "code",
    [
        "import kilter_client",
        "import kilter_client.stream",
        "from kilter_client.cli import run; assert run(['identify', '--help']) == 0",
    ],
)
def test_nothing_heavy_is_loaded(code: str) -> None:
    assert loaded(code) == set()


def test_a_csv_needs_no_package() -> None:
    code = """
import pathlib, tempfile
from kilter_client import prepare
folder = pathlib.Path(tempfile.mkdtemp())
(folder / "lab.csv").write_text("a;b\\n1,5;2\\n")
(folder / "map.toml").write_text('[file]\\ndelimiter=";"\\ndecimal=","\\n[columns]\\nq1_deg={from="a",unit="rad"}')
prepare(folder / "lab.csv", column_map=folder / "map.toml")
"""
    assert loaded(code) == set()
