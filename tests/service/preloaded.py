"""Libraries that a process loads before all others, so that its machine seems to behave in another way."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SOURCES = Path(__file__).parent / "preload"


def preloaded(name: str, folder: Path) -> Path:
    """Compile a library for ``LD_PRELOAD``; the test is skipped where that cannot be done."""
    compiler = shutil.which("cc")
    if compiler is None or not sys.platform.startswith("linux"):
        pytest.skip("there is no C compiler, or this is not Linux")
    made = folder / f"{name}.so"
    command = [compiler, "-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o", str(made), str(SOURCES / f"{name}.c")]
    subprocess.run([*command, "-ldl"], check=True)
    return made
