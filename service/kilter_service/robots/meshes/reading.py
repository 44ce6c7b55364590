"""STL (binary or text) and OBJ into triangles, strictly: every refusal says what is wrong and where."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.limits import MAX_TRIANGLES

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Triangles = NDArray[np.float64]


HEADER, RECORD = 84, 50  # bytes of a binary STL: its head with the count, and each triangle
MAX_COORDINATE = 1e6
MAX_CORNERS = 64  # of a face


def triangles(content: bytes, form: str) -> Triangles:
    """Return the corners (T, 3, 3) of the triangles of a file, in its own unit.

    Raises:
        ServiceError: it is not such a file, or it has no triangle, too many, or a number that cannot be.

    """
    found = np.array(list(_obj(_text(content))) if form == "obj" else _stl(content), dtype=np.float64).reshape(-1, 3, 3)
    if not len(found):
        raise invalid_mesh_error("it has no triangle")
    if not np.isfinite(found).all() or np.abs(found).max() > MAX_COORDINATE:
        raise invalid_mesh_error(f"a coordinate is not a number, or beyond {MAX_COORDINATE:g}")
    if not np.ptp(found.reshape(-1, 3), axis=0).max() > 0.0:
        raise invalid_mesh_error("all its corners are the same point")
    return found


def invalid_mesh_error(why: str) -> ServiceError:
    """Return the refusal of a file."""
    return ServiceError(
        f"This cannot be a mesh: {why}. Write it again as STL or OBJ with triangles.", code="mesh_invalid"
    )


def _stl(content: bytes) -> Sequence[float] | Triangles:
    """A binary file says how long it is; one that is as long as it says is binary, also when it begins with `solid`."""
    count = int.from_bytes(content[80:HEADER], "little") if len(content) >= HEADER else -1
    if count >= 0 and len(content) == HEADER + RECORD * count:
        _check_count(count)
        record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
        return np.asarray(np.frombuffer(content, record, count, HEADER)["corners"], dtype=np.float64)
    if content.lstrip()[:5].lower() == b"solid":
        return list(_text_stl(_text(content)))
    raise invalid_mesh_error(
        f"it says {max(count, 0)} triangles, which are {HEADER + RECORD * max(count, 0)} bytes, and has {len(content)}"
    )


def _text(content: bytes) -> Iterator[tuple[int, list[str]]]:
    try:
        lines = content.decode("utf-8").splitlines()
    except UnicodeDecodeError as error:
        raise invalid_mesh_error("it is neither a binary STL nor text") from error
    for number, line in enumerate(lines, 1):
        if words := line.split("#", 1)[0].split():
            yield number, words


def _text_stl(lines: Iterator[tuple[int, list[str]]]) -> Iterator[float]:
    corners = 0
    for number, words in lines:
        first = words[0].lower()
        if first == "vertex":
            corners += 1
            _check_count(corners // 3)
            yield from _point(number, words[1:])
        elif first == "endloop" and corners % 3:
            raise invalid_mesh_error(f"the face that ends in line {number} has other than three corners")
    if corners % 3:
        raise invalid_mesh_error("its last face has other than three corners")


def _obj(lines: Iterator[tuple[int, list[str]]]) -> Iterator[float]:
    points: list[list[float]] = []
    count = 0
    for number, words in lines:
        if words[0] == "v":
            points.append(_point(number, words[1:4]))
        elif words[0] == "f":
            corners = [_corner(number, word, points) for word in words[1 : MAX_CORNERS + 2]]
            if not 3 <= len(corners) <= MAX_CORNERS:
                raise invalid_mesh_error(
                    f"the face in line {number} has fewer than 3 corners or more than {MAX_CORNERS}"
                )
            count += len(corners) - 2
            _check_count(count)
            for second, third in pairwise(corners[1:]):
                for corner in (corners[0], second, third):
                    yield from corner


def _corner(number: int, word: str, points: list[list[float]]) -> list[float]:
    """The point that a corner names: counted from 1, or from the last one back."""
    text = word.partition("/")[0]
    try:
        place = int(text)
        return points[place - 1 if place > 0 else place] if place else points[len(points)]
    except (ValueError, IndexError):
        raise invalid_mesh_error(f"line {number} names point {text[:20]!r}, and {len(points)} came before") from None


def _point(number: int, words: Sequence[str]) -> list[float]:
    try:
        found = [float(word) for word in words]
    except ValueError:
        found = []
    if len(found) != 3 or not all(math.isfinite(value) for value in found):
        raise invalid_mesh_error(f"line {number} has no three numbers")
    return found


def _check_count(count: int) -> None:
    if count > MAX_TRIANGLES:
        raise invalid_mesh_error(f"it has more than {MAX_TRIANGLES} triangles: simplify it")
