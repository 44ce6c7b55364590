"""`python -m tools.lab fuzz`: many requests of every kind to the real application, on SQLite and on PostgreSQL."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

from tests.fuzz.fuzz import fuzz
from tests.fuzz.world import world
from tests.service.postgresql import programs, running_postgresql

ROUND = 500  # requests that one line of the output tells of


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
    began, statuses, faults = time.monotonic(), Counter[int](), dict[str, str]()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="kilter-fuzz-")))
        filled = stack.enter_context(world(folder, url))
        for number, first in enumerate(range(0, cases, ROUND)):
            outcome = fuzz(filled, min(ROUND, cases - first), 1000 * seed + number)
            statuses += outcome.statuses
            for where, example in outcome.faults.items():
                if faults.setdefault(where, example) is example:
                    print(f"- {where}\n    {example}")
            said = ", ".join(f"{count} x {status}" for status, count in sorted(statuses.items()))
            took = time.monotonic() - began
            print(
                f"{name}: {sum(statuses.values())} requests in {took:.0f} s: {said}; {len(faults)} faults", flush=True
            )
    return len(faults)


if __name__ == "__main__":
    sys.exit(main())
