"""A lab's file through its column map: its columns converted, its further files joined, its rows kept and numbered."""

from __future__ import annotations

from collections.abc import Sequence

from kilter_files.maps.column_map import ColumnMap
from kilter_files.maps.columns import expand_patterns
from kilter_files.maps.converted import convert_columns
from kilter_files.maps.joined import add_joined, joined_columns
from kilter_files.maps.nests import number_nests, spread_nests
from kilter_files.maps.rows import keep_rows, number_poses, say_dead
from kilter_files.tables.source import Source
from kilter_files.tables.table import Table


def apply_column_map(source: Source, column_map: ColumnMap, further: Sequence[Source]) -> Table:
    """Return a file in contract columns as ``column_map`` says; ``further`` are the files of its [join] tables.

    Raises:
        FileError: a column that is not there, a cell that is not a number, columns of different lengths, no row left.

    """
    columns = expand_patterns(column_map.columns, source.choices, column_map.path, source.path)
    table = convert_columns(source, columns, column_map.orientation, bare=bool(further))
    if column_map.note:
        table.notes = [column_map.note]
    for join, there in zip(column_map.joins, further, strict=True):
        theirs = convert_columns(there, joined_columns(join, there, column_map.path), join.orientation)
        add_joined(table, source, join, there, theirs, column_map)
    if column_map.marker is not None:
        number_nests(source, table, column_map)
    keep_rows(source, table, column_map.keep, column_map.drop_missing)
    if column_map.marker is not None:
        spread_nests(table)
    say_dead(table)
    if column_map.repeats_deg is not None:
        number_poses(table, column_map.repeats_deg)
    return table
