"""The rows of a mapped file: which are kept, and which share a pose."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from kilter_files.ground.clusters import clusters
from kilter_files.ground.errors import FileError
from kilter_files.ground.units import JOINT, MARKER, column_unit, converter
from kilter_files.maps.column_map import Keep
from kilter_files.tables.source import Source, row_line_numbers
from kilter_files.tables.table import Table
from kilter_files.tables.text_source import TextSource

LINK = re.compile(r"link\d+_(deg|rad|mm|m)")


def keep_rows(source: Source, table: Table, keep: tuple[Keep, ...], drop_missing: bool) -> None:
    """Keep the rows that meet the conditions and lack nothing.

    Raises:
        FileError: a cell is empty and its row is not to be dropped, or no row is left.

    """
    good = set(table.lines)
    for condition in keep:
        before = len(good)
        good &= _meeting(source, condition)
        if before != len(good):
            table.warnings.append(f"{before - len(good)} rows left out by the condition on {condition.column!r}")
    kept = [i for i, line in enumerate(table.lines) if line in good]
    empty = _empty_cells(table, kept)
    if empty and not drop_missing:
        row, name = min(empty.items())
        place = f"{source.path}, {_row_location(source, table.lines[row])}"
        raise FileError(
            f"{place}: {name} is missing. Fill the cell, or set drop_missing = true under "
            f"[rows] to leave such rows out ({len(empty)} of {len(kept)}).",
            file=str(source.path),
            line=table.lines[row],
            column=name,
        )
    if empty:
        table.warnings.append(f"{len(empty)} rows left out because a value is missing")
        # The arm was there all the same: who derives directions must know that these rows do not follow one another.
        number = {i: float(k) for k, i in enumerate(kept, 1)}
        table.columns.setdefault("row", [number.get(i, math.nan) for i in range(len(table))])
    table.keep([i for i in kept if i not in empty])
    if not len(table):
        raise FileError(f"{source.path}: no row is left. Loosen the conditions under [rows].", file=str(source.path))


def _meeting(source: Source, condition: Keep) -> set[int]:
    """Lines of the rows that meet a condition."""
    if condition.equals:
        good = [text in condition.equals for text in source.texts(condition.column)]
    else:
        low = -math.inf if condition.minimum is None else condition.minimum
        high = math.inf if condition.maximum is None else condition.maximum
        good = [low <= value <= high for value in source.numbers(condition.column)]
    lines = list(zip(row_line_numbers(source, good), good, strict=True))
    return {line for line, is_good in lines if is_good} - {line for line, is_good in lines if not is_good}


def _empty_cells(table: Table, rows: Sequence[int]) -> dict[int, str]:
    """The column of an empty cell by its row; markers may be missing."""
    needed = {name: values for name, values in table.columns.items() if not MARKER.fullmatch(name)}
    return {i: name for name, values in needed.items() for i in rows if math.isnan(values[i])}


def _row_location(source: Source, line: int) -> str:
    return source.row_location(line) if isinstance(source, TextSource) else f"line {line}"


def say_dead(table: Table) -> None:
    """Say which link-side encoders never change though others do: they are not connected."""
    still = {name: len(set(values)) == 1 for name, values in table.columns.items() if LINK.fullmatch(name)}
    dead = [name for name, is_still in still.items() if is_still]
    if dead and len(dead) < len(still):
        one = len(dead) == 1
        table.warnings.append(
            f"{', '.join(dead)} {'is' if one else 'are'} the same in every row: {'a dead channel' if one else 'dead channels'}"
        )


def number_poses(table: Table, tolerance_deg: float) -> None:
    """Rows whose joints agree within the tolerance (1 mm counts as 1 deg) share a pose_id, numbered as they come."""
    labels = []
    for name, values in table.columns.items():
        if JOINT.fullmatch(name):
            convert = converter(column_unit(name) or "", "deg") or converter(column_unit(name) or "", "mm")
            assert convert is not None  # joints are angles or lengths
            labels.append(clusters([convert(value) for value in values], tolerance_deg))
    numbers: dict[tuple[int, ...], int] = {}
    table.columns["pose_id"] = [float(numbers.setdefault(key, len(numbers) + 1)) for key in zip(*labels, strict=True)]
    table.notes.append(f"pose_id: {len(numbers)} poses among {len(table)} rows, by equal joints")
