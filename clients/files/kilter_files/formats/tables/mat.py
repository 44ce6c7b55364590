"""MATLAB .mat files (up to version 7) as columns: ``q[:,0]`` counts from 0, ``q(:,1)`` as MATLAB does."""

from __future__ import annotations

import math
import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from kilter_files.ground.errors import FileError, fault, read_head
from kilter_files.ground.later import need, np

HEAD_BYTES = 128
COMPRESSED, MATRIX = 15, 14
SPARSE = 5
PIECE = 1 << 20
MOST_UNPACKED = 2 << 30
AGAIN = "Save it again in MATLAB with '-v7'."


def check_mat(path: Path) -> None:
    """Follow the variables of a version 5 to 7 file; files of other versions are left to their reader.

    Raises:
        FileError: cut off, a variable that unpacks to more than is sensible, or one larger than its bytes.

    """
    head = read_head(path, HEAD_BYTES)
    if not head.startswith(b"MATLAB 5.0"):
        return
    order = {b"IM": "<", b"MI": ">"}.get(head[126:128])
    if order is None:
        raise fault(path, "its header does not say the order of its bytes", AGAIN, byte=126)
    size, at, total = path.stat().st_size, HEAD_BYTES, 0
    with path.open("rb") as stream:
        while at < size:
            stream.seek(at)
            tag = stream.read(8)
            kind, length = struct.unpack(f"{order}II", tag) if len(tag) == 8 else (0, size)
            if at + 8 + length > size:
                raise fault(path, f"is cut off: a variable states {length} bytes", AGAIN, byte=at)
            total += _check(path, stream, kind, length, order, at)
            if total > MOST_UNPACKED:
                raise fault(path, f"unpacks to more than {MOST_UNPACKED >> 30} GB", "Save fewer variables.", byte=at)
            at += 8 + length


def _check(path: Path, stream: BinaryIO, kind: int, length: int, order: str, at: int) -> int:
    """Check one variable and return how many bytes it unpacks to."""
    if kind != COMPRESSED:
        _check_shape(path, stream.read(min(length, 256)), length, order, at)
        return length
    unpack, left, total, head = zlib.decompressobj(), length, 0, b""
    try:
        while left and not unpack.eof and total <= MOST_UNPACKED:
            piece = stream.read(min(PIECE, left))
            left -= len(piece)
            while piece and total <= MOST_UNPACKED:
                found = unpack.decompress(piece, PIECE)
                head += found[: 264 - len(head)]
                total, piece = total + len(found), unpack.unconsumed_tail
    except zlib.error as error:
        raise fault(path, f"a variable cannot be unpacked ({error})", AGAIN, byte=at) from error
    if len(head) >= 8:
        inner, stated = struct.unpack_from(f"{order}II", head)
        if inner == MATRIX and stated + 8 > total:
            raise fault(path, f"a variable states {stated} bytes and unpacks to {total}", AGAIN, byte=at)
        _check_shape(path, head[8:], total, order, at)
    return total


def _check_shape(path: Path, head: bytes, length: int, order: str, at: int) -> None:
    """Refuse a matrix whose shape needs more elements than it has bytes: array flags, then its dimensions."""
    if len(head) < 24:
        return
    _, flag_bytes, flags, _, _, shape_bytes = struct.unpack_from(f"{order}6I", head)
    if flag_bytes != 8 or not 8 <= shape_bytes <= 128 or len(head) < 24 + shape_bytes:
        return
    shape = struct.unpack_from(f"{order}{shape_bytes // 4}i", head, 24)
    if flags & 0xFF != SPARSE and (min(shape) < 0 or math.prod(shape) > length):
        said = " x ".join(map(str, shape))
        raise fault(path, f"a variable claims the shape {said} in {length} bytes", AGAIN, byte=at)


EXPRESSION = re.compile(
    r"(?P<name>[A-Za-z]\w*(?:\.\w+)*)\s*(?:(?P<kind>[\[(])\s*(?P<row>:|\d+)\s*,\s*(?P<col>:|\d+)"
    r"(?:\s*,\s*(?P<page>:|\d+))?\s*[\])])?"
)
MATRICES = ((3, 3), (3, 4), (4, 4))
MOST_COLUMNS = 200
MOST_ACROSS, WIDER = 9, 3  # an array of so few rows that is so many times wider holds a pose in each column


@dataclass
class MatSource:
    """A read .mat file. Rows have no lines: they are numbered from 1."""

    path: Path
    variables: Mapping[str, Any]
    missing: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        self.names = sorted(self.variables)

    @property
    def lines(self) -> list[int]:
        """No numbering before a column is known: the mapping counts the rows of the first one."""
        return []

    @property
    def choices(self) -> list[str]:
        """Every column of every variable, written both ways: ``q[:,0]`` and ``q(:,1)``; rows of one that lies across."""
        out: list[str] = []
        for name, value in _flatten_variables(self.variables):
            array = np.asarray(value)
            if array.dtype.kind in "iufb" and array.ndim == 2 and _lies_across(*array.shape):
                out += [f"{name}[{k},:]" for k in range(array.shape[0])]
                out += [f"{name}({k + 1},:)" for k in range(array.shape[0])]
            elif array.dtype.kind in "iufb" and array.ndim == 2 and array.shape[1] <= MOST_COLUMNS:
                out += [f"{name}[:,{k}]" for k in range(array.shape[1])]
                out += [f"{name}(:,{k + 1})" for k in range(array.shape[1])]
            elif array.dtype.kind in "iufb" and array.ndim == 3:
                out += _places_in_matrices(name, array.shape)
            elif array.dtype.kind in "iufb" and array.ndim == 1:
                out.append(name)
        return out

    def has(self, name: str | int) -> bool:
        """Tell whether the expression picks a column."""
        try:
            self.numbers(name)
        except FileError:
            return False
        return True

    def texts(self, name: str | int) -> list[str]:
        """Return a column as text, for row filters."""
        return [f"{value:g}" for value in self.numbers(name)]

    def numbers(self, name: str | int) -> list[float]:
        """Return the column of an expression such as ``mA[:,2]`` or ``log.q(:,3)``.

        Raises:
            FileError: not such an expression, no such variable, or an index outside its shape.

        """
        match = EXPRESSION.fullmatch(str(name).strip())
        if not match:
            raise self._error(name, 'is not a column of a .mat file: write "q[:,0]" (from 0), "q(:,1)" (from 1) or "t"')
        array = self._array(name, match["name"])
        if (array.ndim == 3) != (match["page"] is not None):
            raise self._error(
                name, f"names {2 if match['page'] is None else 3} places of an array of shape {array.shape}"
            )
        column = array if match["kind"] is None else self._slice(name, array, match)
        if column.ndim != 1:
            raise self._error(name, f'has shape {array.shape}: name one column, for example "{match["name"]}[:,0]"')
        missing = set(self.missing)
        return [math.nan if value in missing else value for value in column.astype(float).tolist()]

    def _array(self, expression: str | int, name: str) -> Any:
        value: Any = self.variables
        for part in name.split("."):
            if not isinstance(value, Mapping) or part not in value:
                raise self._error(expression, f"needs a variable {name!r}; the file has {', '.join(self.names)}")
            value = value[part]
        array = np.asarray(value)
        if array.dtype.kind not in "iufb" or array.ndim not in (1, 2, 3):
            raise self._error(expression, f"is not a real array (type {array.dtype}, shape {array.shape})")
        return array

    def _slice(self, expression: str | int, array: Any, match: re.Match[str]) -> Any:
        first = 0 if match["kind"] == "[" else 1
        if array.ndim == 3:
            return self._slice_matrices(expression, array, match, first)
        if array.ndim == 1:
            array = array.reshape(-1, 1)
        if (match["row"] == ":") == (match["col"] == ":"):
            raise self._error(expression, 'must keep one direction whole: "q[:,0]" or "q[0,:]"')
        axis = 1 if match["row"] == ":" else 0
        index = int(match["col"] if axis else match["row"]) - first
        if not 0 <= index < array.shape[axis]:
            raise self._error(expression, f"is outside the array, whose shape is {array.shape}")
        return array[:, index] if axis else array[index]

    def _slice_matrices(self, expression: str | int, array: Any, match: re.Match[str], first: int) -> Any:
        said = [match["row"], match["col"], match["page"]]
        if said.count(":") != 1:
            raise self._error(expression, 'must keep one direction whole: "T[0,3,:]"')
        index = tuple(slice(None) if one == ":" else int(one) - first for one in said)
        inside = all(isinstance(k, slice) or 0 <= k < size for k, size in zip(index, array.shape, strict=True))
        if not inside:
            raise self._error(expression, f"is outside the array, whose shape is {array.shape}")
        return array[index]

    def _error(self, expression: str | int, why: str) -> FileError:
        return FileError(f"{self.path}: {expression!r} {why}.", file=str(self.path), column=expression)


def _places_in_matrices(name: str, shape: tuple[int, ...]) -> list[str]:
    """The elements of matrices that lie behind one another, each a column: ``T[0,3,:]`` and ``T(1,4,:)``."""
    if shape[:2] in MATRICES:
        return [
            f"{name}{left}{i + first},{j + first},:{right}"
            for left, right, first in (("[", "]", 0), ("(", ")", 1))
            for i in range(shape[0])
            for j in range(shape[1])
        ]
    if shape[1:] in MATRICES:
        return [
            f"{name}{left}:,{i + first},{j + first}{right}"
            for left, right, first in (("[", "]", 0), ("(", ")", 1))
            for i in range(shape[1])
            for j in range(shape[2])
        ]
    return []


def _lies_across(rows: int, columns: int) -> bool:
    """Whether an array has the numbers of a pose below one another, as MATLAB's functions want vectors."""
    return rows <= MOST_ACROSS and columns > WIDER * rows


def _flatten_variables(variables: Mapping[str, Any], stem: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in variables.items():
        if isinstance(value, Mapping):
            yield from _flatten_variables(value, f"{stem}{name}.")
        else:
            yield f"{stem}{name}", value


def read_mat(path: Path, missing: tuple[float, ...] = ()) -> MatSource:
    """Read a .mat file with scipy.

    Raises:
        MissingPackageError: scipy is not installed.
        FileError: no .mat file, or one of version 7.3.

    """
    scipy_io = need(f"{path}: .mat files need", "scipy", "scipy.io")
    check_mat(path)
    try:
        content = scipy_io.loadmat(path, simplify_cells=True)
    except NotImplementedError as error:
        raise FileError(f"{path}: a .mat file of version 7.3. Save it in MATLAB with '-v7'.", file=str(path)) from error
    except Exception as error:  # of a damaged file scipy lets zlib.error, KeyError, IndexError and more through
        raise FileError(f"{path}: is not a .mat file that scipy can read ({error}).", file=str(path)) from error
    return MatSource(path, {name: value for name, value in content.items() if not name.startswith("__")}, missing)
