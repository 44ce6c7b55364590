"""Square markers as rectangles."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

from kilter_files.rig.printed import WHITE, Rect


def marker_shapes(
    aruco: tuple[Any, Any], number: int, left: float, top: float, side: float, cells: int
) -> Iterator[Rect]:
    """Draw a marker of a dictionary, given with its OpenCV, from its upper left corner; ``cells`` count its border."""
    cv2, dictionary = aruco
    cell = side / cells
    black = cv2.aruco.generateImageMarker(dictionary, number, cells) == 0
    yield Rect(left, top - side, side, side)
    for k in range(cells):
        for start, length in _white(black[k]):
            yield Rect(left + start * cell, top - (k + 1) * cell, length * cell, cell, WHITE)


def _white(cells: Any) -> Iterator[tuple[int, int]]:
    at = 0
    for black, group in itertools.groupby(bool(cell) for cell in cells):
        length = len(list(group))
        if not black:
            yield at, length
        at += length
