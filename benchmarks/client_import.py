"""Importing the client, in fresh interpreters."""

from __future__ import annotations

import subprocess
import sys
import time

from benchmarks.table import Line

TARGET_MS, ROUNDS = 150.0, 7


def lines() -> list[Line]:
    """Shortest time of ``import kilter_client`` over a bare interpreter's start."""
    bare = min(_seconds("pass") for _ in range(ROUNDS))
    with_client = min(_seconds("import kilter_client") for _ in range(ROUNDS))
    took = (with_client - bare) * 1e3
    return [Line("import kilter_client", f"{took:.0f} ms", f"<= {TARGET_MS:.0f} ms", took <= TARGET_MS)]


def _seconds(statement: str) -> float:
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", statement], check=True)
    return time.perf_counter() - began
