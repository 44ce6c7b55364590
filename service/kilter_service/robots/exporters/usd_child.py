"""Makes a stage of USD: ``python -m kilter_service.robots.exporters.usd_child``, in a folder with what is asked."""

from __future__ import annotations

import pickle
from pathlib import Path

from kilter_service.ground.child_process import confine
from kilter_service.robots.exporters.usd_file import ASKED, MADE, stage_text


def main() -> None:
    """Write the stage as text."""
    confine()
    version, documentation = pickle.loads(Path(ASKED).read_bytes())  # noqa: S301 (our own)
    Path(MADE).write_text(stage_text(version, documentation), encoding="utf-8")


if __name__ == "__main__":
    main()
