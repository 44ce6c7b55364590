"""A cube with a board on every face, as a net to cut out: one shape, so that the faces lie true to each other.

Its frame is in its middle, along the axes of the front face: x right, y down, z into the cube. Seen from outside, each face
has its own x right, y down and z into the cube.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from kilter_files.ground.errors import UsageError
from kilter_files.rig.board_layout import (
    AROUND_MM,
    DICTIONARIES,
    Board,
    Point,
    check_board,
    dictionary,
    page_for,
    smallest_page,
)
from kilter_files.rig.printed import Printed, Rect, Shape, Stroke, Text, check_ending, marker_shapes, save_described

Vector = tuple[float, float, float]
FOLD = (0.75, 0.75, 0.75)


@dataclass(frozen=True)
class Face:
    """A face: its place in the net (columns right, rows down, from the front), and its axes on the cube."""

    name: str
    net: tuple[int, int]
    x: Vector
    y: Vector
    into: Vector


FACES = (
    Face("front", (0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
    Face("right", (1, 0), (0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    Face("left", (-1, 0), (0, 0, -1), (0, 1, 0), (1, 0, 0)),
    Face("top", (0, -1), (1, 0, 0), (0, 0, -1), (0, 1, 0)),
    Face("bottom", (0, 1), (1, 0, 0), (0, 0, 1), (0, -1, 0)),
    Face("back", (0, 2), (1, 0, 0), (0, -1, 0), (0, 0, -1)),
)
NET = (3, 4)


@dataclass(frozen=True)
class Cube:
    """A cube of ``edge_mm``; ``board`` is that of the front, the others have the numbers after it."""

    board: Board
    edge_mm: float

    def boards(self) -> list[tuple[Face, Board]]:
        """Return every face with its board."""
        count = len(self.board.markers())
        return [(face, replace(self.board, first_id=self.board.first_id + k * count)) for k, face in enumerate(FACES)]

    def on_cube(self, face: Face, point: tuple[float, float]) -> list[float]:
        """Return a point of a face's board in the cube's frame, mm."""
        across, down = (value - size / 2 for value, size in zip(point, self.board.size_mm, strict=True))
        axes = zip(face.x, face.y, face.into, strict=True)
        return [round(across * x + down * y - self.edge_mm / 2 * z, 6) + 0.0 for x, y, z in axes]


def check_cube(board: Board, edge_mm: float | None) -> Cube:
    """Return the cube with this board on its faces.

    Raises:
        UsageError: faces that are not square, an edge too short, more markers than the dictionary has.

    """
    check_board(board)
    if board.columns != board.rows:
        raise UsageError("--cube: the faces of a cube are square: give as many --columns as --rows.")
    white = 0.0 if board.kind == "apriltag" else board.square_mm / 2  # tags have white around them in their squares
    least = board.size_mm[0] + white
    edge = least + white if edge_mm is None else edge_mm
    if not (math.isfinite(edge) and edge >= least):
        raise UsageError(f"--edge-mm {edge:g}: give {least:g} mm or more: around a board its face must be white.")
    needed, held = board.first_id + 6 * len(board.markers()), DICTIONARIES[board.dictionary][1]
    if needed > held:
        raise UsageError(f"--dictionary {board.dictionary} has {held} markers, and the cube needs {needed}.")
    return Cube(board, edge)


def save_cube(cube: Cube, path: Path, page: str | None = None) -> dict[str, Any]:
    """Write the net as ``.pdf`` or ``.svg`` and its JSON beside it; returns that document.

    Raises:
        UsageError: another ending, or a cube that fits no page.
        FileError: a file cannot be written.
        MissingPackageError: OpenCV, or for PDF reportlab, is not installed.

    """
    check_ending(path, "a cube")
    return save_described(cube_document(cube, page), cube_page(cube, page), path)


def cube_document(cube: Cube, page: str | None = None) -> dict[str, Any]:
    """Return what the JSON file holds: the front board's fields, and all corners and markers in the cube's frame."""
    name, (width, height) = _page(cube, page)
    plain = cube.board.to_document()
    faces, markers, corners = [], [], []
    for k, (face, board) in enumerate(cube.boards()):
        middle = _middle(cube, face)
        left, top = width / 2 + middle[0] - board.size_mm[0] / 2, height / 2 - middle[1] - board.size_mm[1] / 2
        faces.append({"name": face.name, "first_id": board.first_id, "left_mm": left, "top_mm": top})
        for number, four in board.markers().items():
            markers.append({"id": number, "corners_mm": [cube.on_cube(face, corner) for corner in four]})
        first = board.first_corner(k)
        for number, point in board.corners().items():
            places = dict(zip(("x_mm", "y_mm", "z_mm"), cube.on_cube(face, point), strict=True))
            corners.append({"id": first + number, "face": face.name} | places)
    length = ruler_mm(cube.edge_mm)
    return plain | {
        "solid": "cube",
        "edge_mm": cube.edge_mm,
        "frame": "in the cube's middle, along the front face: x right, y down, z into the cube; mm",
        "faces": faces,
        "markers": markers,
        "corners": corners,
        "page": {"name": name, "width_mm": width, "height_mm": height},
        "rulers_mm": {"across": length, "upright": length},
    }


def cube_page(cube: Cube, page: str | None = None) -> Printed:
    """Return the page of a cube.

    Raises:
        UsageError: the net does not fit.
        MissingPackageError: OpenCV is not installed.

    """
    return Printed(_title(cube), _page(cube, page)[1], tuple(_shapes(cube)))


def _shapes(cube: Cube) -> Iterator[Shape]:
    half = cube.edge_mm / 2
    for face, board in cube.boards():
        x, y = _middle(cube, face)
        square = ((x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half))
        yield Stroke((*square, square[0]), 0.15, FOLD)
        yield from board_shapes(board, (x, y))
        yield Text(x, y + half - min(4.0, board.square_mm / 2.2), face.name, min(2.4, board.square_mm / 4))
    x, y = _middle(cube, FACES[2])
    low = y - half - RULER_OUT_MM
    length = ruler_mm(cube.edge_mm)
    yield from ruler_shapes(length, lambda at, out: (x + at, low - out))
    right = _middle(cube, FACES[1])[0] - half + RULER_OUT_MM + 4
    middle = _middle(cube, FACES[5])[1]
    yield from ruler_shapes(length, lambda at, out: (right + out, middle + at))
    words = f"Print at 100 %. Both rulers are {length:g} mm: measure them. Cut out, fold back along the lines."
    top = _middle(cube, FACES[3])[1] + half
    yield Text(0, top + 6, _title(cube), 2.4)
    yield Text(0, top + 2.5, words, 2.4)


def _title(cube: Cube) -> str:
    board, last = cube.board, max(cube.boards()[-1][1].markers())
    sizes = f"squares {board.square_mm:g} mm, markers {board.marker_mm:g} mm"
    return f"{board.kind} cube of {cube.edge_mm:g} mm, {sizes}, {board.dictionary}, {board.first_id} to {last}"


def _middle(cube: Cube, face: Face) -> tuple[float, float]:
    """Middle of a face on the page, from the page's middle, y up; the net's middle is half an edge below the front's."""
    return face.net[0] * cube.edge_mm, (0.5 - face.net[1]) * cube.edge_mm


def _page(cube: Cube, page: str | None) -> tuple[str, tuple[float, float]]:
    width, height = (n * cube.edge_mm + AROUND_MM for n in NET)
    return smallest_page(width, height, page, upright=True)


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
    return Printed(_board_title(board), page_for(board, page)[1], shapes)


def _board_title(board: Board) -> str:
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
    yield Text(0, height / 2 + 8, _board_title(board), size)
    across, upright = ruler_mm(width), ruler_mm(height)
    words = f"Print at 100 %. The rulers are {across:g} mm (below) and {upright:g} mm (left): measure them."
    yield Text(0, height / 2 + 4.5, words, size)
