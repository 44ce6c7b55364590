"""Rows of a file that the server sent, column by column."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.errors import FileError
from kilter_client.results.tables import Tabular, column_array, numpy_for
from kilter_files.ground import did_you_mean

if TYPE_CHECKING:
    import numpy as np


class Rows(Tabular):
    """A table of the server: ``rows["dx_mm"]`` is a numpy array, the unit is in the name; NaN is an empty cell."""

    def __init__(self, content: bytes, columns: Mapping[str, list[Any]] | None = None) -> None:
        self.content = content
        self._columns = _of_csv(content) if columns is None else dict(columns)
        self._length = len(next(iter(self._columns.values()), ()))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(self._columns)

    def __getitem__(self, name: str) -> np.ndarray[Any, Any]:
        if name not in self._columns:
            raise KeyError(
                f"there is no column {name!r}{did_you_mean(name, self._columns)} in {', '.join(self._columns)}"
            )
        return column_array(numpy_for("A column"), self._columns[name])  # type: ignore[no-any-return]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return self._length

    def to_dict(self) -> dict[str, list[Any]]:
        """Return the columns by name; None is an empty cell."""
        return dict(self._columns)

    def save(self, path: Path | str) -> Path:
        """Write the file, byte for byte as it came.

        Raises:
            FileError: the file cannot be written.

        """
        return write_file(self.content, path)

    def __repr__(self) -> str:
        return f"{len(self)} rows: {', '.join(self._columns)}"


def write_file(content: bytes, path: Path | str) -> Path:
    """Write bytes to a file and return its path.

    Raises:
        FileError: the file cannot be written.

    """
    file = Path(path)
    try:
        file.write_bytes(content)
    except OSError as error:
        raise FileError(f"{file}: cannot be written: {error.strerror or error}.", file=str(file)) from error
    return file


def saved_together(contents: Mapping[Path, bytes]) -> None:
    """Write files that belong together: all of them or none, and what was there before then stays.

    Raises:
        FileError: one cannot be written.

    """
    mark = os.urandom(4).hex()
    new = {file: file.with_name(f".{file.name}.{mark}") for file in contents}
    before: dict[Path, bytes | None] = {}
    file = next(iter(contents))
    try:
        for file, content in contents.items():
            new[file].write_bytes(content)
        for file in contents:
            was = file.read_bytes() if file.exists() else None
            os.replace(new[file], file)
            before[file] = was
    except OSError as error:
        for one, content_before in before.items():
            one.unlink() if content_before is None else one.write_bytes(content_before)
        raise FileError(f"{file}: cannot be written: {error.strerror or error}.", file=str(file)) from error
    finally:
        for one in new.values():
            one.unlink(missing_ok=True)


def _of_csv(content: bytes) -> dict[str, list[Any]]:
    names, *lines = list(csv.reader(io.StringIO(content.decode()))) or [[]]
    return {name: _values([line[k] for line in lines]) for k, name in enumerate(names)}


def _values(cells: list[str]) -> list[Any]:
    """A column as whole numbers, as numbers, or as the words that stand there."""
    for kind in (int, float):
        try:
            return [None if cell == "" else kind(cell) for cell in cells]
        except ValueError:
            continue
    return list(cells)
