"""Draws a board for a camera: ``python -m kilter_service.page.drop.board COLUMNS ROWS SIDE`` writes ``board.zip``."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

from kilter_files.ground import KilterError
from kilter_files.rig import USUAL, Board, check_board, save_board
from kilter_service.ground.child_process import confine
from kilter_service.page.drop.routes import BOARD, REFUSED

MARKER = 0.75  # side of a marker, of a square


def main() -> None:
    """Draw it, or say why not."""
    confine()
    columns, rows, square = int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
    try:
        made = Board("charuco", columns, rows, square, MARKER * square, USUAL["charuco"], 0)
        save_board(check_board(made), Path("board.svg"))
    except KilterError as error:
        Path(REFUSED).write_text(error.detail, encoding="utf-8")
        return
    with zipfile.ZipFile(BOARD, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("board.svg", "board.json"):
            archive.write(name)


if __name__ == "__main__":
    main()
