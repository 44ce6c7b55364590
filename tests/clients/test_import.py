"""The package loads little, so that scripts and the command start fast."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from kilter_client.cli.catalogue import ENTRIES

HEAVY = ("httpx", "rich", "numpy", "scipy", "pyarrow", "zenoh", "anyio", "ssl", "pydantic", "click", "pygments")


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
        "from kilter_client.cli import run; assert run(['--help']) == 0",
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


def test_the_help_imports_no_command() -> None:
    script = """
import sys
from kilter_client.cli import run
run(['--help'])
print(*[name for name in sys.modules if name.startswith('kilter_client.cli.')])
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    found = {name.removeprefix("kilter_client.cli.") for name in done.stdout.splitlines()[-1].split()}
    assert not found & {entry.module for entry in ENTRIES.values()}


@pytest.mark.parametrize("command", [["versions", "ROBOT"], ["jobs"], ["upload", "ROBOT", "FILE"]])
def test_a_command_loads_what_it_needs(robot: str, write_campaign: Callable[..., Path], command: list[str]) -> None:
    given = [{"ROBOT": robot, "FILE": str(write_campaign())}.get(word, word) for word in command]
    needed = {"httpx", "anyio", "ssl"}
    assert loaded(f"from kilter_client.cli import run; assert run({given!r}) == 0") <= needed


def test_values_of_commands_are_looked_at_as_typer_does(tmp_path: Path) -> None:
    """What quick_start lets through without pydantic is refused in the same cases."""
    (tmp_path / "file.csv").write_text("")
    script = f"""
from kilter_client.cli import run
for given in (
    ["upload", "arm", "{tmp_path}/nowhere.csv"], ["upload", "arm", "{tmp_path}"],
    ["upload", "arm", "{tmp_path}/file.csv", "--role", "x"], ["server", "jobs", "list", "--limit", "x"],
    ["identify", "arm", "--level", "4"], ["upload", "arm"],
):
    assert run(given) == 2
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    words = (
        "does not exist",
        "is a directory",
        "is not one of 'train'",
        "valid integer",
        "less than or equal to 3",
        "FILE",
    )
    lines = done.stderr.replace("\n  ", " ").splitlines()  # one that is wider than a screen is several, indented
    assert len(lines) == len(words)
    assert all(word in line for word, line in zip(words, lines, strict=True)), lines
