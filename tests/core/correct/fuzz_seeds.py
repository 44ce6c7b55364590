"""Programs of every arm and effect as the inputs that `tools.lab fuzz-c` begins with, each with what a controller does."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from tests.core.correct.c_corrector import blob_of
from tests.core.correct.parity import programs

DRIVEN_BYTES = 600


def main() -> None:
    """Write them into the folder that is named."""
    folder, rng = Path(sys.argv[1]), np.random.default_rng(0)
    folder.mkdir(parents=True, exist_ok=True)
    for number, (_, program) in enumerate(programs()):
        (folder / str(number)).write_bytes(blob_of(program) + rng.bytes(DRIVEN_BYTES) + b"\1")


if __name__ == "__main__":
    main()
