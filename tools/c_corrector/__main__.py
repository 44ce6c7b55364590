"""Write the C corrector from the kernels, or say whether the one that is kept is today's: ``--check``."""

from __future__ import annotations

import sys
from pathlib import Path

from tools.c_corrector.assemble import assembled

PLACE = Path(__file__).parents[2] / "clients" / "c"


def main() -> int:
    """Write the files; with ``--check`` only compare."""
    stale = [name for name, text in assembled().items() if not _is(PLACE / name, text)]
    if "--check" in sys.argv:
        if stale:
            print(f"{', '.join(stale)}: not what the kernels say. Run python -m tools.c_corrector and commit.")
        return 1 if stale else 0
    for name, text in assembled().items():
        (PLACE / name).write_text(text)
    return 0


def _is(file: Path, text: str) -> bool:
    return file.is_file() and file.read_text() == text


if __name__ == "__main__":
    sys.exit(main())
