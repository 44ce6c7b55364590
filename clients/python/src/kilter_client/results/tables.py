"""Tables: columns with units in their names as lists, numpy arrays or a DataFrame, and in a notebook."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

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
