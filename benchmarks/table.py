"""One table: what was measured, beside the target and whether it is met."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Line:
    """One figure; ``target`` is empty where there is none."""

    what: str
    value: str
    target: str = ""
    met: bool | None = None


def best_of(work: Callable[[], object], rounds: int) -> float:
    """Shortest time of ``rounds`` runs in seconds, the first run left out: other processes only ever add."""
    work()
    times = []
    for _ in range(rounds):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return min(times)


def show(lines: list[Line]) -> str:
    """The lines as a table in columns."""
    words = {True: "met", False: "MISSED", None: ""}
    rows = [("", "measured", "target", ""), *((n.what, n.value, n.target, words[n.met]) for n in lines)]
    widths = [max(len(row[k]) for row in rows) for k in range(4)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )
