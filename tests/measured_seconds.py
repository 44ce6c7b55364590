"""What `tools.lab cpu` measured of each test: which modules begin first, and which tests `make test` leaves to the gate."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import NamedTuple

SECONDS = Path(__file__).with_name("seconds.txt")
HEAD = """# Seconds of processor and clock of tests and, under its name, of a module's fixtures; written by tools.lab cpu.
# What is long runs in the gate (make test LONG=1) and not in make test.
"""
LEAST_S, LEAST_CLOCK_S = 0.7, 4.0  # what takes less of both is not written down
LONG_S = 0.8  # of the processor, of a test by itself
LONG_FIXTURES_S = 8.0  # of a module before its first test and after its last: all its tests are long
KEPT_S = 10.0  # where all tests of a module are long, the shortest of them stays if it takes no longer


class Took(NamedTuple):
    """Seconds of the processor and of the clock."""

    cpu_s: float
    clock_s: float


class Row(NamedTuple):
    """What was measured of a test, or of the fixtures of a module."""

    took: Took
    is_long: bool
    name: str


def measured() -> list[Row]:
    """What was written down."""
    if not SECONDS.is_file():
        return []
    rows = [row.split(maxsplit=3) for row in SECONDS.read_text(encoding="utf-8").splitlines() if row[:1] != "#"]
    return [Row(Took(float(cpu), float(clock)), mark == "long", name) for cpu, clock, mark, name in rows]


def rows_of(tests: Mapping[str, Took], fixtures: Mapping[str, Took]) -> list[Row]:
    """Decide what is long, of tests by themselves and of the fixtures of their modules."""
    by_module: dict[str, dict[str, Took]] = defaultdict(dict)
    for test, took in tests.items():
        by_module[test.partition("::")[0]][test] = took
    rows = []
    for module, inside in by_module.items():
        whole = fixtures[module].cpu_s > LONG_FIXTURES_S
        long = {test for test, took in inside.items() if took.cpu_s > LONG_S}
        shortest = min(inside, key=lambda test: inside[test].cpu_s)
        if len(long) == len(inside) and inside[shortest].cpu_s < KEPT_S:
            long.discard(shortest)
        rows += [Row(fixtures[module], whole, module), *(Row(inside[test], test in long, test) for test in inside)]
    kept = [row for row in rows if row.took.cpu_s >= LEAST_S or row.took.clock_s >= LEAST_CLOCK_S]
    return sorted(kept, key=lambda row: (-row.took.cpu_s, row.name))


def write(rows: list[Row], modules: Collection[str]) -> None:
    """Write down what was measured of these modules; what stands there of others stays, while there are such modules."""
    root = SECONDS.parent.parent
    names = {row: row.name.partition("::")[0] for row in measured()}
    others = [row for row, module in names.items() if module not in modules and (root / module).is_file()]
    lines = [
        f"{row.took.cpu_s:6.1f} {row.took.clock_s:6.1f} {'long' if row.is_long else '-':4} {row.name}\n"
        for row in sorted([*rows, *others], key=lambda row: (-row.took.cpu_s, row.name))
    ]
    SECONDS.write_text(HEAD + "".join(lines), encoding="utf-8")
