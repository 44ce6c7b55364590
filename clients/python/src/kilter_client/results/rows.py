"""Tables, columns with units in their names, and rows of a file that the server sent."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.errors import FileError
from kilter_files.ground import did_you_mean
from kilter_files.ground.later import need

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd

MOST_ROWS = 60  # of a table in a notebook
PACKAGES = "numpy pandas matplotlib"
OTHERWISE = "call to_dict(), which needs nothing"


class Tabular:
    """Columns, as lists, numpy arrays or a DataFrame; a table in a notebook."""

    def to_dict(self) -> dict[str, list[Any]]:
        """Return the columns by name."""
        return {}

    def to_numpy(self) -> np.ndarray[Any, Any]:
        """Return the rows as a structured array; a missing number is NaN.

        Raises:
            MissingPackageError: numpy is not installed.

        """
        numpy = numpy_for("to_numpy()")
        columns = {name: column_array(numpy, values) for name, values in self.to_dict().items()}
        rows = len(next(iter(columns.values()), ()))
        out = numpy.empty(rows, dtype=[(name, column.dtype) for name, column in columns.items()])
        for name, column in columns.items():
            out[name] = column
        return out  # type: ignore[no-any-return]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray[Any, Any]:
        found = self.to_numpy()
        return found if dtype is None else found.astype(dtype)

    def to_pandas(self) -> pd.DataFrame:
        """Return a pandas DataFrame.

        Raises:
            MissingPackageError: pandas is not installed.

        """
        pandas = need("to_pandas() needs", "pandas", install=PACKAGES, instead=OTHERWISE)
        return pandas.DataFrame(self.to_dict())

    def _repr_html_(self) -> str:
        columns = {name: values for name, values in self.to_dict().items() if any(v not in (None, "") for v in values)}
        return html_table([*columns], [[number(v) for v in row] for row in zip(*columns.values(), strict=True)])


def numpy_for(what: str) -> Any:
    """Return numpy.

    Raises:
        MissingPackageError: it is not installed.

    """
    return need(f"{what} needs", "numpy", install=PACKAGES, instead=OTHERWISE)


def column_array(numpy: Any, values: Sequence[Any]) -> Any:
    """Return a column as an array: numbers as floats if one of them is missing, words as words."""
    if all(v is None or (isinstance(v, int | float) and not isinstance(v, bool)) for v in values):
        whole = bool(values) and all(isinstance(v, int) for v in values)
        return numpy.array([math.nan if v is None else v for v in values], dtype=int if whole else float)
    if all(isinstance(v, bool) for v in values):
        return numpy.array(values, dtype=bool)
    return numpy.array(["" if v is None else str(v) for v in values])


def number(value: Any, digits: int = 4) -> str:
    """Write a value shortly, nothing for None."""
    if value is None:
        return ""
    return f"{value + 0.0:.{digits}g}" if isinstance(value, float) else str(value)  # no -0


def html_table(head: Sequence[str], rows: Sequence[Sequence[str]], title: str = "") -> str:
    """Return a table for a notebook; every cell is escaped, long tables end with how many rows there are more."""
    cells = "".join(f"<th>{escape(name)}</th>" for name in head)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows[:MOST_ROWS])
    more = f"<p>and {len(rows) - MOST_ROWS} rows more</p>" if len(rows) > MOST_ROWS else ""
    caption = f"<caption>{escape(title)}</caption>" if title else ""
    return f"<table>{caption}<thead><tr>{cells}</tr></thead><tbody>{body}</tbody></table>{more}"


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
