"""What it costs that SQLite waits for the disk at every commit (``python -m benchmarks.commits``)."""

from __future__ import annotations

import os
import sqlite3
import statistics
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

COMMITS, CHUNKS, CHUNK_BYTES = 300, 20, 4 << 20


def main() -> None:
    """Print a row of the table in docs/explanation/durability.md for each way to commit."""
    folder = sys.argv[1] if len(sys.argv) > 1 else None
    print("| synchronous | small commit p50, p95 | chunk of 4 MB p50, p95 |")
    print("|---|---|---|")
    for mode in ("NORMAL", "FULL"):
        small, large = measured(mode, folder, COMMITS, 200), measured(mode, folder, CHUNKS, CHUNK_BYTES)
        print(f"| {mode} | {_said(small)} | {_said(large)} |")


def measured(mode: str, folder: str | None, count: int, size: int) -> list[float]:
    """Return the milliseconds that each commit took."""
    times = []
    with (
        tempfile.TemporaryDirectory(dir=folder) as data,
        closing(sqlite3.connect(Path(data) / "some.sqlite", isolation_level=None)) as connection,
    ):
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute(f"PRAGMA synchronous={mode}")
        connection.execute("CREATE TABLE chunks (id INTEGER PRIMARY KEY, content BLOB)")
        for _ in range(count):
            content = os.urandom(size)
            start = time.perf_counter()
            connection.execute("BEGIN IMMEDIATE")
            connection.execute("INSERT INTO chunks (content) VALUES (?)", (content,))
            connection.execute("COMMIT")
            times.append((time.perf_counter() - start) * 1e3)
    return times


def _said(times: list[float]) -> str:
    cuts = statistics.quantiles(times, n=20)
    return f"{statistics.median(times):.2f} ms, {cuts[18]:.2f} ms"


if __name__ == "__main__":
    main()
