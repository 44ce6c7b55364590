"""`make fuzz`: many requests of every kind to the real application, on SQLite and on PostgreSQL."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from tests.fuzz.fuzz import fuzz
from tests.fuzz.world import world
from tests.service.postgresql import programs, running_postgresql


def main() -> int:
    """Fuzz; returns 1 when an answer was not as promised."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=20_000, help="requests on SQLite")
    parser.add_argument("--postgresql", type=int, default=2_000, help="requests on PostgreSQL")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    faults = _run("SQLite", arguments.cases, arguments.seed, None)
    if arguments.postgresql and programs() is not None:
        with running_postgresql() as url:
            faults += _run("PostgreSQL", arguments.postgresql, arguments.seed, url)
    elif arguments.postgresql:
        print("PostgreSQL is not installed: nothing was sent to it", file=sys.stderr)
        return 1
    return 1 if faults else 0


def _run(name: str, cases: int, seed: int, url: str | None) -> int:
    if not cases:
        return 0
    began = time.monotonic()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="kilter-fuzz-")))
        outcome = fuzz(stack.enter_context(world(folder, url)), cases, seed)
    statuses = ", ".join(f"{count} x {status}" for status, count in sorted(outcome.statuses.items()))
    total, took = sum(outcome.statuses.values()), time.monotonic() - began
    print(f"{name}: {total} requests in {took:.0f} s, seed {seed}: {statuses}; {len(outcome.faults)} faults")
    for where, example in outcome.faults.items():
        print(f"- {where}\n    {example}")
    return len(outcome.faults)


if __name__ == "__main__":
    sys.exit(main())
