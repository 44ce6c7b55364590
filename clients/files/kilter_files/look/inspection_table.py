"""How an unknown table is read: its layout, its columns with ranges, and how to send it."""

from __future__ import annotations

import csv
from pathlib import Path
from shlex import quote
from typing import Any

from kilter_files.ground.faults import head_of
from kilter_files.look.draft import draft
from kilter_files.look.draft_guess import Columns
from kilter_files.look.table_shape import shape_of

Document = dict[str, Any]

LOOKED_AT = 1 << 16


def lines_in_cells(path: Path) -> bool:
    """Tell whether quoted cells of a text go over several lines."""
    text = head_of(path, LOOKED_AT).decode("utf-8", "replace")
    reader = csv.reader(text.splitlines(keepends=True))
    try:
        return any("\n" in cell for row in reader for cell in row[:-1]) and '"' in text
    except csv.Error:
        return False


def describe_table(path: Path) -> Document:
    """Describe a table that no reader of a device knows.

    Raises:
        FileError: no table of numbers.

    """
    shape = shape_of(path)
    columns = Columns(shape)
    out = []
    for name in columns.names:
        values = columns.numbers(name)
        low, high = (min(values), max(values)) if values else (None, None)
        empty = len(shape.source.lines) - len(values) if values is not None and shape.source.lines else None
        out.append({"name": name, "unit": columns.unit(name), "low": low, "high": high, "empty": empty})
    sheet = [] if shape.layout.sheet is None else [f"sheet {shape.layout.sheet!r}"]
    found = draft(path)
    read = [f"check {text}" for text in found.guessed] + [f"not told: {text}" for text in found.open]
    read += [f"not used: {', '.join(found.unused)}"] if found.unused else []
    note = f"comes in with a column map; a first one: kilter inspect {quote(str(path))} --draft columns.toml"
    return {"kind": "table", "rows": len(shape.source.lines), "columns": out, "notes": [*sheet, *read, note]}
