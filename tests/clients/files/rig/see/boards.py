"""Boards as `kilter measure board` writes them, and pictures of them, made once for all tests."""

from __future__ import annotations

import json
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from kilter_client.cli import run
from tests.clients.files.rig.see.raycaster import BLACK, WHITE, Lens, Page, Shot, clean, finished

CHARUCO = ("--columns", "7", "--rows", "5", "--square-mm", "25", "--dictionary", "6x6_250")
EVEN = ("--columns", "7", "--rows", "6", "--square-mm", "25", "--dictionary", "5x5_100")
TAGS = ("--kind", "apriltag", "--columns", "5", "--rows", "4", "--square-mm", "36", "--marker-mm", "27")
SMALL = Lens(480, 360, (560.0, 560.0), (241.0, 178.0))


@cache
def board(options: tuple[str, ...]) -> tuple[Path, dict[str, Any]]:
    """The JSON file of a board, its SVG beside it, and what it holds."""
    svg = Path(tempfile.mkdtemp()) / "board.svg"
    assert run(["board", *options, "-o", str(svg)]) == 0
    path = svg.with_suffix(".json")
    return path, json.loads(path.read_text())


@cache
def page_of(options: tuple[str, ...], mirrored: bool = False) -> Page:
    path, document = board(options)
    return Page.read(path.with_suffix(".svg"), document, mirrored)


def taken(options: tuple[str, ...], shot: Shot, mirrored: bool = False) -> Any:
    """A picture of a board."""
    return finished(clean(page_of(options, mirrored), board(options)[1], shot), shot)


def small(**how: Any) -> Shot:
    """A small and quick picture from the front, slightly tilted."""
    return Shot(
        **{"rotation_deg": (12.0, -8.0, 4.0), "centre_mm": (0.0, 0.0, 330.0), "lens": SMALL, "samples": 3} | how
    )


def legacy_page(document: dict[str, Any]) -> Page:
    """The board as OpenCV draws it with its legacy pattern."""
    known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    size, square, cells = (document["columns"], document["rows"]), document["square_mm"], 28
    drawn = cv2.aruco.CharucoBoard(size, square, document["marker_mm"], known)
    drawn.setLegacyPattern(True)
    grey = drawn.generateImage((size[0] * cells, size[1] * cells), marginSize=0)
    x, y = (np.arange(n * cells + 1) * square / cells for n in size)
    x, y = np.concatenate([[-20.0], x, [x[-1] + 20]]), np.concatenate([[-20.0], y, [y[-1] + 20]])
    return Page(x, y, np.pad(np.where(grey > 128, WHITE, BLACK), 1, constant_values=WHITE))


def saved(folder: Path, **pictures: Any) -> Path:
    """A folder with these pictures as PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, grey in pictures.items():
        assert cv2.imwrite(str(folder / f"{name}.png"), grey)
    return folder
