"""The table [markers] of a column map: rows that measure one marker each, with a column that names it.

One reflector is moved between nests: every row has its place once, and the nest that it sat in.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

from kilter_files.ground.errors import FileError
from kilter_files.maps.column_map import ColumnMap
from kilter_files.tables.source import Source
from kilter_files.tables.table import Table

NEST = "nest"  # the column while the rows are read; no contract column has that name
PLACE = re.compile(r"([xyz])_(mm|m)")
MOST = 99


def number_nests(source: Source, table: Table, column_map: ColumnMap) -> None:
    """Add the number of each row's marker, in the order of their names or numbers.

    Raises:
        FileError: no place beside it, or more markers than there may be.

    """
    assert column_map.marker is not None
    where = f"{column_map.path}, markers"
    places = {name for name in table.columns if PLACE.fullmatch(name)}
    if len(places) != 3:
        what = "the place of the marker belongs beside it: map x_mm, y_mm and z_mm under [columns]"
        raise FileError(f"{where}: {what}.", file=str(column_map.path), key="markers")
    values, numbers = by_name(source.texts(column_map.marker))
    if len(numbers) > MOST:
        what = (
            f"column {column_map.marker!r} names {len(numbers)} markers, and there may be {MOST}: it is another column"
        )
        raise FileError(f"{where}: {what}.", file=str(column_map.path), key="markers.from")
    table.columns[NEST] = values
    table.notes.append(f"markers from {column_map.marker!r}, one in a row: {describe_numbering(numbers, 'm')}")


def by_name(cells: Sequence[str]) -> tuple[list[float], dict[str, int]]:
    """Numbers from 1 in the order of the names or numbers in the cells, NaN for empty ones; and which name has which."""
    texts = [text.strip() for text in cells]
    named = sorted(set(texts) - {""}, key=lambda text: (len(text) if text.isdecimal() else 0, text))
    numbers = {text: number for number, text in enumerate(named, 1)}
    return [float(numbers.get(text, math.nan)) for text in texts], numbers


def describe_numbering(numbers: Mapping[str, int], prefix: str = "") -> str:
    """Say which of the first names has which number."""
    return ", ".join(f"{prefix}{number} is {text!r}" for text, number in list(numbers.items())[:6])


def spread_nests(table: Table) -> None:
    """Put the place of each row into the columns of its marker; those of the others are empty."""
    numbers = [int(number) for number in table.columns.pop(NEST)]
    for name in [name for name in table.columns if PLACE.fullmatch(name)]:
        values = table.columns.pop(name)
        for marker in range(1, max(numbers, default=0) + 1):
            table.columns[f"m{marker}{name}"] = [
                value if number == marker else math.nan for number, value in zip(numbers, values, strict=True)
            ]
