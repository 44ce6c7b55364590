"""Two commits beside each other: ``python -m benchmarks.beside BEFORE NOW``, files of what ``benchmarks.kernels`` printed."""

from __future__ import annotations

import argparse
import json
from pathlib import Path


def main() -> None:
    """Print the least of each measure, for what disturbs only adds, and the ratio of the two."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("before", type=Path)
    parser.add_argument("now", type=Path)
    given = parser.parse_args()
    before, now = ([json.loads(line) for line in path.read_text().splitlines()] for path in (given.before, given.now))
    print(f"{'µs of processor time':24}{'before':>10}{'now':>10}{'ratio':>8}")
    for name in before[0]:
        old, new = (min(run[name] for run in runs) for runs in (before, now))
        print(f"{name:24}{old:10.3f}{new:10.3f}{new / old:8.3f}")


if __name__ == "__main__":
    main()
