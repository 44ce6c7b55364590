"""All core figures in one table: ``python -m benchmarks.core``. Exit 1 when a target is missed."""

from __future__ import annotations

import sys

from benchmarks import client_import, command, fits, identify, model, server_start
from benchmarks.table import show


def main() -> int:
    """Measure, print, and say whether every target was met."""
    lines = [line for part in (model, client_import, command, server_start, identify, fits) for line in part.lines()]
    print(show(lines))
    return int(any(line.met is False for line in lines))


if __name__ == "__main__":
    sys.exit(main())
