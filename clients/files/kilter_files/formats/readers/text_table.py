"""A lab's own table as text, which comes in through a column map."""

from __future__ import annotations

from pathlib import Path

from kilter_files.formats.marker_header import PRESETS, meaning
from kilter_files.formats.reader import MAP, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.formats.tables.text import read_text
from kilter_files.formats.unknown.understood import cached_understanding, describe_table
from kilter_files.tables.source import Source


class TextTable(Reader[Source]):
    """Delimited text as columns by name."""

    name = "csv"
    title = "delimited text"
    use = MAP
    endings = (".csv", ".txt", ".tsv", ".dat")

    def recognises(self, head: Head) -> bool:
        """Any table of numbers but points alone: a reader of points leaves joints out, or takes them for coordinates."""
        if head.hints.say_points:
            return False
        layout, table = head.layout, cached_understanding(head)
        if layout is None:  # lists in cells, bars between them; or no table, which is refused with its reason
            return True
        if table is None or table.axes:
            return table is not None
        if layout.header:
            return not {"x", "y", "z"} <= set(meaning(layout.names, PRESETS["generic"]))
        numeric = [name for name in table.columns.names if table.columns.numbers(name)]
        return table.shape.layout.header or len(numeric) > len("xyz")

    def describe(self, head: Head) -> Document:
        """Columns with ranges, and what a draft of a map takes them for."""
        shape = {} if head.layout is None else {"layout": head.layout.to_document()}
        return describe_table(head) | shape

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Source:
        """Read the cells."""
        return read_text(path, hints.layout)


READER = TextTable()
