"""A board, or a cube of them, as its JSON file describes it: what a detector must know, and the corners in their order.

Views as Parquet: the columns of their CSV file, numbers as numbers, some rows in memory at a time.
"""

from __future__ import annotations

import csv
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import UsageError, fault
from kilter_files.ground.later import csv as reading
from kilter_files.ground.later import need, pa, parquet
from kilter_files.ground.units import NAMES
from kilter_files.rig.board_layout import Board, Point, check_board, marker_family

MOST_BYTES = 1 << 24
REMEDY = "Take the JSON that kilter measure board wrote, or write one anew with the board's sizes."


@dataclass(frozen=True)
class Target:
    """What to look for; ``corners_mm`` (n, 3) and ``numbers`` are in the order of its file. A board has one face."""

    name: str
    faces: tuple[Board, ...]
    legacy: bool
    numbers: tuple[int, ...]
    corners_mm: Floats

    @property
    def board(self) -> Board:
        """The board, or that of the first face."""
        return self.faces[0]

    @property
    def marker_numbers(self) -> list[int]:
        """Numbers of its markers."""
        return sorted(number for face in self.faces for number in face.markers())

    def on_face(self, face: int) -> dict[int, Point]:
        """Return where the corners of a face are on its own plane, by number."""
        first = self.board.first_corner(face)
        return {first + number: point for number, point in self.faces[face].corners().items()}

    def column_by_number(self) -> dict[int, int]:
        """Place of every corner's number in the order of the file, from 0."""
        return {number: k for k, number in enumerate(self.numbers)}

    def to_document(self) -> dict[str, Any]:
        """Return the board as a campaign names it, without its mount."""
        return {"name": self.name, "corners_mm": [[round(v, 6) for v in corner] for corner in self.corners_mm.tolist()]}


def read_target(path: Path) -> Target:
    """Read the JSON of a board.

    Raises:
        FileError: no JSON, a field that is missing or wrong, corners that are not those of its squares.

    """
    document = _document(path)
    board = _board(path, document)
    legacy = document.get("legacy_pattern", False)
    if not isinstance(legacy, bool):
        raise fault(path, "legacy_pattern is neither true nor false", REMEDY)
    numbers, corners = _corners(path, document)
    name = str(document.get("name") or path.stem)
    target = Target(name, _faces(path, document, board), legacy, numbers, corners)
    wanted = [number for face in range(len(target.faces)) for number in target.on_face(face)]
    if sorted(numbers) != sorted(wanted):
        what = (
            f"has {len(numbers)} corners, but {board.columns} x {board.rows} squares from {board.first_id} have others"
        )
        raise fault(path, what, REMEDY)
    for face in range(len(target.faces)):
        _check_distances(path, target, face)
    return target


def _check_distances(path: Path, target: Target, face: int) -> None:
    """Refuse corners whose distances are not those of the squares; where they are is free."""
    own, column = target.on_face(face), target.column_by_number()
    places = target.corners_mm[[column[number] for number in own]]
    flat = np.array(list(own.values()))
    off = np.abs(np.linalg.norm(places - places[0], axis=1) - np.linalg.norm(flat - flat[0], axis=1))
    if off.max() > 0.1 * target.board.square_mm:
        worst = list(own)[int(off.argmax())]
        what = f"corner {worst} is {off.max():.3g} mm from where squares of {target.board.square_mm:g} mm put it"
        raise fault(path, what, REMEDY)


def _faces(path: Path, document: dict[str, Any], board: Board) -> tuple[Board, ...]:
    """Boards of all faces: the board itself, or those of a cube."""
    given = document.get("faces")
    if given is None:
        return (board,)
    if not isinstance(given, list) or not all(isinstance(face, dict) for face in given) or not 1 <= len(given) <= 20:
        raise fault(path, "its faces are not a list of 1 to 20 objects", REMEDY)
    firsts = [int(_number(path, face, "first_id", whole=True)) for face in given]
    try:
        faces = tuple(check_board(replace(board, first_id=first)) for first in firsts)
    except UsageError as error:
        raise fault(path, str(error).rstrip("."), REMEDY) from error
    markers = [number for face in faces for number in face.markers()]
    if len(set(markers)) != len(markers):
        raise fault(path, "two of its faces have a marker in common", REMEDY)
    return faces


def check_apart(targets: list[Target]) -> None:
    """Refuse boards that one picture could not tell apart.

    Raises:
        UsageError: two boards of one name, or with markers in common.

    """
    for k, one in enumerate(targets):
        for other in targets[:k]:
            if one.name == other.name:
                raise UsageError(f'--board: two boards are called {one.name}: give one a "name" in its JSON.')
            both = set(one.marker_numbers) & set(other.marker_numbers)
            if both and marker_family(one.board.dictionary) == marker_family(other.board.dictionary):
                what = f"--board: {other.name} and {one.name} both have marker {min(both)}"
                raise UsageError(f"{what}: print one with other numbers (kilter measure board --first-id).")


def _document(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > MOST_BYTES:
            raise fault(path, "is too large for a board", REMEDY)
        found = json.loads(path.read_bytes())
    except OSError as error:
        raise fault(path, f"cannot be read: {error.strerror or error}", REMEDY) from error
    except (ValueError, RecursionError) as error:
        raise fault(path, f"is not JSON: {str(error)[:120]}", REMEDY) from error
    if not isinstance(found, dict):
        raise fault(path, "is not a JSON object", REMEDY)
    return found


def _board(path: Path, document: dict[str, Any]) -> Board:
    if document.get("kind") not in ("charuco", "apriltag"):
        raise fault(path, f"its kind is {document.get('kind')!r}, neither charuco nor apriltag", REMEDY)
    whole = {name: _number(path, document, name, whole=True) for name in ("columns", "rows", "first_id")}
    sizes = {name: _number(path, document, name) for name in ("square_mm", "marker_mm")}
    columns, rows, first = (int(whole[name]) for name in ("columns", "rows", "first_id"))
    dictionary = str(document.get("dictionary"))
    try:
        if max(columns, rows) > 200:
            raise UsageError(f"{columns} x {rows} squares are too many")
        return check_board(
            Board(document["kind"], columns, rows, sizes["square_mm"], sizes["marker_mm"], dictionary, first)
        )
    except UsageError as error:
        raise fault(path, str(error).rstrip("."), REMEDY) from error


def _number(path: Path, document: dict[str, Any], name: str, whole: bool = False) -> float:
    value = document.get(name, 0 if name == "first_id" else None)
    fits = isinstance(value, int) if whole else isinstance(value, int | float) and math.isfinite(value)
    if isinstance(value, bool) or not fits or value is None:
        raise fault(path, f"{name} is {value!r}, not a {'whole ' if whole else ''}number", REMEDY)
    return float(value)


def _corners(path: Path, document: dict[str, Any]) -> tuple[tuple[int, ...], Floats]:
    given = document.get("corners")
    try:
        numbers = tuple(int(corner["id"]) for corner in given or [])
        mm = [[float(corner.get(f"{axis}_mm", 0.0)) for axis in "xyz"] for corner in given or []]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise fault(path, "a corner has no id, x_mm or y_mm that is a number", REMEDY) from error
    corners = np.array(mm, dtype=np.float64).reshape(-1, 3)
    if not numbers or not np.isfinite(corners).all() or len(set(numbers)) != len(numbers):
        raise fault(path, "its corners are missing, twice there or not finite", REMEDY)
    return numbers, corners


BLOCK_BYTES = 1 << 24  # of the CSV file, read at once


def check_pyarrow(output: Path) -> None:
    """Refuse before any picture is read.

    Raises:
        MissingPackageError: pyarrow is not installed.

    """
    need(f"{output}: Parquet files need", "pyarrow")


def write_parquet(views: Path, output: Path) -> None:
    """Write the rows of a CSV file of views; empty cells are null."""
    with views.open(encoding="utf-8", newline="") as stream:
        names = next(csv.reader(stream))
    convert = reading.ConvertOptions(
        column_types={name: pa.string() if name in NAMES else pa.float64() for name in names}, null_values=[""]
    )
    rows = reading.open_csv(views, reading.ReadOptions(block_size=BLOCK_BYTES), convert_options=convert)
    with parquet.ParquetWriter(output, rows.schema, compression="zstd") as writer:
        for batch in rows:
            writer.write_batch(batch)
