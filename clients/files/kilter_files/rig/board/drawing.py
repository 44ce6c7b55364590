"""A board as a page, with rulers to check the printer, and its JSON file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from kilter_files.rig.board.layout import Board, Point, page_for
from kilter_files.rig.board.opencv import dictionary
from kilter_files.rig.printed import Printed, Rect, Shape, Stroke, Text, check_ending, marker_shapes, save_described

RULER_OUT_MM = 5.0  # from the squares to a ruler's line
LONGEST_RULER_MM = 250.0


def save_board(board: Board, path: Path, page: str | None = None) -> dict[str, Any]:
    """Write the board as ``.pdf`` or ``.svg`` and its JSON beside it; returns that document.

    Raises:
        UsageError: another ending, or a board that fits no page.
        FileError: a file cannot be written.
        MissingPackageError: OpenCV, or for PDF reportlab, is not installed.

    """
    check_ending(path, "a board")
    return save_described(board_document(board, page), board_page(board, page), path)


def board_document(board: Board, page: str | None = None) -> dict[str, Any]:
    """Return what the JSON file holds: the board, and where its origin is on the page, from its upper left corner."""
    name, size = page_for(board, page)
    left, top = ((side - own) / 2 for side, own in zip(size, board.size_mm, strict=True))
    place = {"name": name, "width_mm": size[0], "height_mm": size[1], "left_mm": left, "top_mm": top}
    across, upright = (ruler_mm(side) for side in board.size_mm)
    return board.to_document() | {"page": place, "rulers_mm": {"across": across, "upright": upright}}


def ruler_mm(side_mm: float) -> float:
    """Return the length of the ruler beside a side: whole tens, or whole mm of a small board."""
    step = 10.0 if side_mm >= 20 else 1.0
    return min(LONGEST_RULER_MM, step * (side_mm // step))


def board_page(board: Board, page: str | None = None) -> Printed:
    """Return the page of a board.

    Raises:
        UsageError: the board does not fit.
        MissingPackageError: OpenCV is not installed.

    """
    shapes = (*board_shapes(board), *_rulers(board), *_words(board))
    return Printed(_title(board), page_for(board, page)[1], shapes)


def _title(board: Board) -> str:
    sizes = f"squares {board.square_mm:g} mm, markers {board.marker_mm:g} mm"
    last = max(board.markers())
    return f"{board.kind} {board.columns} x {board.rows}, {sizes}, {board.dictionary}, {board.first_id} to {last}"


def board_shapes(board: Board, middle: Point = (0.0, 0.0)) -> Iterator[Shape]:
    """Squares and markers of a board whose middle is there, from the page's, y up."""
    yield from _squares(board, middle)
    yield from _markers(board, middle)


def _on_page(board: Board, middle: Point, point: Point) -> Point:
    width, height = board.size_mm
    return middle[0] + point[0] - width / 2, middle[1] + height / 2 - point[1]


def _squares(board: Board, middle: Point) -> Iterator[Shape]:
    for corner in board.black_squares():
        x, y = _on_page(board, middle, corner)
        yield Rect(x, y - board.square_mm, board.square_mm, board.square_mm)


def _markers(board: Board, middle: Point) -> Iterator[Shape]:
    known = dictionary(board.dictionary)
    for number, corners in board.markers().items():
        left, top = _on_page(board, middle, corners[0])
        yield from marker_shapes(known, number, left, top, board.marker_mm, board.cells)


def _rulers(board: Board) -> Iterator[Shape]:
    """One below the squares and one on their left, each from the middle of its side."""
    width, height = board.size_mm
    below, aside = -height / 2 - RULER_OUT_MM, -width / 2 - RULER_OUT_MM
    yield from ruler_shapes(ruler_mm(width), lambda at, out: (at, below - out))
    yield from ruler_shapes(ruler_mm(height), lambda at, out: (aside - out, at))


def ruler_shapes(length: float, place: Callable[[float, float], Point]) -> Iterator[Shape]:
    """A ruler whose ``place`` says where a distance along it, from its middle, and one outwards are on the page."""
    yield Stroke((place(-length / 2, 0.0), place(length / 2, 0.0)), 0.1)
    for k in range(round(length) + 1):
        size = 3.0 if k % 10 == 0 else 2.0 if k % 5 == 0 else 1.2
        at = k - length / 2
        yield Stroke((place(at, 0.0), place(at, size)), 0.1)


def _words(board: Board) -> Iterator[Shape]:
    width, height = board.size_mm
    size = max(1.2, min(2.6, width / 55))
    yield Text(0, height / 2 + 8, _title(board), size)
    across, upright = ruler_mm(width), ruler_mm(height)
    words = f"Print at 100 %. The rulers are {across:g} mm (below) and {upright:g} mm (left): measure them."
    yield Text(0, height / 2 + 4.5, words, size)
